"""Rendered rooms: what is in an image stands where the lens projects it, at every row's own instant."""

from dataclasses import replace

import numpy as np
import pytest

from gnomon.errors import OptionError
from gnomon.geometry.rotations import rotation_from_rotvec
from gnomon.models.camera import Camera
from gnomon.simulate import RoomScenario, simulate_camera_imu
from gnomon.simulate.images.room_images import Surfaces, furnished_room, render_room, room_images, texture_levels
from gnomon.simulate.walk import half_axes

LENS = Camera(
    projection="pinhole",
    intrinsics=np.array([115.0, 114.6, 80.6, 59.3]),
    distortion="radtan",
    distortion_coeffs=np.array([-0.28, 0.075, 0.0002, -0.00015]),
    resolution=(160, 120),
)


def room_with_spot():
    """Return a black room of 4 m with a bright spot of 6 cm on its wall, and the spot's middle [m]."""
    room = Surfaces.box(
        np.zeros(3), np.eye(3), np.array([4.0, 2.6, 4.0]), "plain", np.random.default_rng(1), inside=True
    )
    black = [np.zeros_like(face[0]) for face in room.levels]
    black[4][500:524, 900:924] = 200  # the wall ahead, at z = -2 m
    place = room.corner[4] + room.texel_m * (912 * room.axes[4, 0] + 512 * room.axes[4, 1])
    return replace(room, levels=tuple(texture_levels(face) for face in black)), place


def centroid(image):
    rows, cols = np.indices(image.shape)
    return np.array([(cols * image).sum(), (rows * image).sum()]) / image.sum()


def looking_ahead(turn):
    """Return the pose of the room for a camera that looks along -z."""
    R = rotation_from_rotvec(np.array(turn)) @ np.diag([1.0, -1.0, -1.0])
    return R, -R @ np.array([0.1, 0.05, 0.2])


@pytest.mark.parametrize("turn", [(0.0, 0.0, 0.0), (0.1, -0.15, 0.7)])
def test_a_spot_is_where_the_lens_projects_it(turn):
    room, place = room_with_spot()
    R, p = looking_ahead(turn)
    image = render_room((room,), LENS, R[None], p[None])
    expected = LENS.project((R @ place + p)[None]).pixels[0]
    assert np.abs(centroid(image) - expected).max() < 0.05


def test_each_row_has_its_own_pose():
    room, place = room_with_spot()
    turns = [(0.0, 0.002 * row, 0.0) for row in range(120)]
    R, p = (np.array(part) for part in zip(*map(looking_ahead, turns), strict=True))
    seen = centroid(render_room((room,), LENS, R, p))
    row = round(seen[1])
    assert np.abs(seen - LENS.project((R[row] @ place + p[row])[None]).pixels[0]).max() < 0.1


def test_furniture_hides_the_wall_behind_it():
    room, place = room_with_spot()
    box = Surfaces.box(0.6 * place, np.eye(3), np.full(3, 0.4), "plain", np.random.default_rng(2))
    R, p = looking_ahead((0.0, 0.0, 0.0))
    column, row = np.rint(LENS.project((R @ place + p)[None]).pixels[0]).astype(int)
    assert render_room((room,), LENS, R[None], p[None])[row, column] > 150
    assert render_room((room, box), LENS, R[None], p[None])[row, column] < 150


def test_a_mirror_shows_what_is_before_it():
    """A spot on the wall behind the camera, at z = 2 m, is seen where it would be at z = -6 m."""
    room, _ = room_with_spot()
    black = [np.zeros_like(face[0]) for face in room.levels]
    black[5][500:524, 700:724] = 200
    place = room.corner[5] + room.texel_m * (712 * room.axes[5, 0] + 512 * room.axes[5, 1])
    room = replace(room, levels=tuple(texture_levels(face) for face in black))
    R, p = looking_ahead((0.1, -0.15, 0.7))
    assert not render_room((room,), LENS, R[None], p[None]).any()
    image = render_room((room,), LENS, R[None], p[None], mirror=True)
    reflected = np.array([place[0], place[1], -4.0 - place[2]])
    assert np.abs(centroid(image) - LENS.project((R @ reflected + p)[None]).pixels[0]).max() < 0.1
    # what stands before the mirror hides it
    box = Surfaces.box(np.array([0.0, 0.0, -1.0]), np.eye(3), np.full(3, 1.6), "plain", np.random.default_rng(2))
    hidden = render_room((room, box), LENS, R[None], p[None], mirror=True)
    plain = render_room((room, box), LENS, R[None], p[None])
    seen = plain > 0
    assert seen.any()
    assert np.array_equal(hidden[seen], plain[seen])


def test_people_walk_beside_what_stands_there():
    scenario, middle = RoomScenario(furniture=2), np.zeros(3)
    alone, together = furnished_room(scenario, middle, 3), furnished_room(replace(scenario, people=2), middle, 3)
    assert all(np.array_equal(a.corner, b.corner) for a, b in zip(alone, together, strict=False))
    assert [bool(one.swing.any()) for one in together] == [False, False, False, True, True]


def test_a_walk_leads_once_round_between_the_boxes():
    lens = {"resolution": (160, 120), "intrinsics": tuple(LENS.intrinsics)}
    scenario = RoomScenario(motion="walk", duration_s=20.0, furniture=12, surface="plain", **lens)
    simulation = simulate_camera_imu(scenario.rig(), 3)
    R, p = simulation.trajectory.path.pose(np.linspace(0, scenario.duration_s, 400))
    steps = np.diff(p, axis=0)
    assert 20.0 < np.linalg.norm(steps[:, [0, 2]], axis=1).sum() < 29.0  # 1.0 to 1.4 m/s, and some sway
    assert np.linalg.norm(p[-1] - p[0]) < 0.3
    ahead = np.einsum("ij,ij->i", R[:-1, :, 2], steps) / np.linalg.norm(steps, axis=1)
    assert np.median(ahead) > 0.9
    middle = simulation.trajectory.path.middle + np.array([0.0, 0.0, simulation.scenario.distance_m])
    walls, *boxes = furnished_room(scenario, middle, 3, half_axes(simulation.trajectory.path))
    assert (np.abs(p - middle).max(axis=0) < np.abs(walls.corner - middle).max(axis=0) - 1.0)[[0, 2]].all()
    inside = []
    for box in boxes:
        place = box.corner.mean(axis=0) + np.einsum("fa,faj->j", box.size, box.axes) / 12
        away = np.linalg.norm((p - place)[:, [0, 2]], axis=1)
        assert 0.3 < away.min() - np.linalg.norm(box.size[2]) / 2 < 1.5
        inside.append(np.linalg.norm(place - middle) < np.linalg.norm(p[away.argmin()] - middle))
    assert 0 < sum(inside) < len(boxes)
    image = next(iter(room_images(scenario, simulation).streams["cam0"].frames([]))).decode()
    assert (image > 20).mean() > 0.9


def test_images_repeat_and_the_rest_of_the_rig_stays_the_same():
    scenario = RoomScenario(duration_s=0.5, resolution=(160, 120), intrinsics=tuple(LENS.intrinsics), furniture=2)
    simulation = simulate_camera_imu(scenario.rig(), 3)
    images = [next(iter(room_images(scenario, simulation).streams["cam0"].frames([]))).decode() for _ in range(2)]
    assert np.array_equal(*images)
    assert images[0].std() > 20
    middle = np.zeros(3)
    assert len(furnished_room(replace(scenario, moving=1), middle, 3)) == 4


def test_a_painted_room_shows_nothing_to_follow():
    scenario = RoomScenario(surface="plain", furniture=0)
    (walls,) = furnished_room(scenario, np.zeros(3), 1)
    assert all(np.ptp(face[0]) == 0 for face in walls.levels)


def test_a_narrow_room_is_refused():
    with pytest.raises(OptionError, match="not waved"):
        RoomScenario(room_m=(4.0, 1.0, 4.0))
