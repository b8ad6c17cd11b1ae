"""Points of a scene: followed from image to image, and found again in another view."""

import cv2
import numpy as np
import pytest

from gnomon.detect.tracks import Landmarks, cut_pieces, follow_points
from gnomon.geometry.rotations import rotation_from_rotvec
from gnomon.models.camera import Camera

K = np.array([[200.0, 0.0, 119.5], [0.0, 200.0, 89.5], [0.0, 0.0, 1.0]])
LENS = Camera(
    projection="pinhole",
    intrinsics=K[[0, 1, 0, 1], [0, 1, 2, 2]],
    distortion="none",
    distortion_coeffs=[],
    resolution=(240, 180),
)


def textured(seed=1):
    """Return an image (180, 240) with texture of all sizes."""
    rng = np.random.default_rng(seed)
    image = np.full((180, 240), 120.0, np.float32)
    for cell, level in ((40, 20), (12, 20), (4, 15)):
        part = rng.normal(0, level, (180 // cell + 2, 240 // cell + 2)).astype(np.float32)
        image += cv2.resize(part, None, fx=cell, fy=cell, interpolation=cv2.INTER_CUBIC)[:180, :240]
    return np.clip(image, 0, 255).astype(np.uint8)


def shifted(image, u, v):
    return cv2.warpAffine(image, np.array([[1.0, 0, u], [0, 1.0, v]]), (240, 180), flags=cv2.INTER_CUBIC)


def test_points_follow_the_image():
    image = textured()
    tracks = follow_points([image, shifted(image, 2.3, -1.4), shifted(image, 4.6, -2.8)])
    first, last = tracks.shared(0, 2)
    assert len(first) > 20
    moved = tracks.pixels[last] - tracks.pixels[first]
    assert np.abs(np.median(moved, axis=0) - (4.6, -2.8)).max() < 0.06


def test_a_plain_wall_has_no_points():
    rng = np.random.default_rng(2)
    walls = [(100 + rng.normal(0, 2, (180, 240))).astype(np.uint8) for _ in range(2)]
    assert len(follow_points(walls).track) == 0


@pytest.mark.parametrize("near", [True, False])
def test_landmarks_are_found_in_a_turned_view(near):
    image = textured(3)
    pixels = np.array([[80.3, 70.2], [150.6, 100.9], [120.0, 85.0]])
    points = np.column_stack([(pixels - K[:2, 2]) / 200.0, np.ones(3)]) * 2.0
    pieces, blurred = cut_pieces([(0, image)], np.zeros(3, np.int64), pixels)
    landmarks = Landmarks(
        camera=LENS,
        points=points,
        R_anchor=np.tile(np.eye(3), (3, 1, 1)),
        p_anchor=np.zeros((3, 3)),
        pieces=pieces,
        blurred=blurred,
    )
    R, p = rotation_from_rotvec(np.array([0.03, -0.05, 0.35])), np.array([0.05, -0.03, 0.1])
    view = cv2.warpPerspective(image, K @ (R + np.outer(p, [0, 0, 0.5])) @ np.linalg.inv(K), (240, 180))
    off = np.array([0.004, -0.003, 0.0]) if near else np.array([0.04, -0.03, 0.0])
    which, found = landmarks.find(view, LENS, rotation_from_rotvec(off) @ R, p, reach_px=20.0, near=near)
    assert which.tolist() == [0, 1, 2]
    assert np.abs(found - LENS.project(points @ R.T + p).pixels).max() < 0.1


def test_perspective_within_a_piece_does_not_move_landmarks_together():
    # what a lens stretches towards the edge of the image was taken for 0.03 px of motion, of all landmarks at once
    image = textured(6)
    pixels = np.stack(np.meshgrid([30.3, 55.2, 80.7, 105.4], [40.6, 65.1, 90.8, 115.3, 140.2]), axis=2).reshape(-1, 2)
    count = len(pixels)
    points = np.column_stack([(pixels - K[:2, 2]) / 200.0, np.ones(count)])
    pieces, blurred = cut_pieces([(0, image)], np.zeros(count, np.int64), pixels)
    landmarks = Landmarks(
        camera=LENS,
        points=points,
        R_anchor=np.tile(np.eye(3), (count, 1, 1)),
        p_anchor=np.zeros((count, 3)),
        pieces=pieces,
        blurred=blurred,
    )
    R = rotation_from_rotvec(np.array([0.0, 0.35, 0.0]))
    view = cv2.warpPerspective(image, K @ R @ np.linalg.inv(K), (240, 180), flags=cv2.INTER_CUBIC)
    which, found = landmarks.find(view, LENS, R, np.zeros(3), reach_px=20.0, near=True)
    assert len(which) > 10
    off = found - LENS.project(points[which] @ R.T).pixels
    assert abs(off.mean(axis=0)[0]) < 0.02


def test_landmarks_are_not_found_in_another_scene():
    pixels = np.array([[80.0, 70.0], [150.0, 100.0]])
    pieces, blurred = cut_pieces([(0, textured(3))], np.zeros(2, np.int64), pixels)
    points = np.column_stack([(pixels - K[:2, 2]) / 200.0, np.ones(2)])
    landmarks = Landmarks(
        camera=LENS,
        points=points,
        R_anchor=np.tile(np.eye(3), (2, 1, 1)),
        p_anchor=np.zeros((2, 3)),
        pieces=pieces,
        blurred=blurred,
    )
    for near in (True, False):
        assert len(landmarks.find(textured(4), LENS, np.eye(3), np.zeros(3), reach_px=20.0, near=near)[0]) == 0
        behind = np.array([0.0, 0.0, -5.0])
        assert len(landmarks.find(textured(3), LENS, np.eye(3), behind, reach_px=20.0, near=near)[0]) == 0


def test_tiles_look_like_each_other():
    image = textured(5)
    tiles = np.tile(image[:60, :60], (3, 4))
    pixels = np.array([[70.0, 65.0], [130.0, 65.0], [80.0, 110.0], [140.0, 110.0]])
    likeness = []
    for picture in (image, tiles):
        pieces, blurred = cut_pieces([(0, picture)], np.zeros(4, np.int64), pixels)
        landmarks = Landmarks(
            camera=LENS,
            points=np.ones((4, 3)),
            R_anchor=np.tile(np.eye(3), (4, 1, 1)),
            p_anchor=np.zeros((4, 3)),
            pieces=pieces,
            blurred=blurred,
        )
        likeness.append(landmarks.likeness())
    assert likeness[0] < 0.6
    assert likeness[1] > 0.99
