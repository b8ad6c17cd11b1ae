"""Single images without a board: sharpness, light and size."""

import cv2
import numpy as np
import pytest

from gnomon.assess.checks.image_checks import check_looks, check_sizes, edge_blur, measure_image
from gnomon.models.camera import Camera


def scene(seed=1, size=(480, 640)):
    """Return many rectangles at all angles, with sharp edges."""
    rng = np.random.default_rng(seed)
    image = np.full(size, 128, np.uint8)
    for _ in range(120):
        box = cv2.boxPoints(((rng.uniform(0, size[1]), rng.uniform(0, size[0])), tuple(rng.uniform(40, 120, 2)),
                             rng.uniform(0, 90)))  # fmt: skip
        cv2.fillPoly(image, [np.rint(box).astype(np.int32)], int(rng.integers(20, 230)), lineType=cv2.LINE_AA)
    return image


def pictured(image, blur_px=0.7, noise=2.0, seed=2):
    sharp = cv2.GaussianBlur(image.astype(np.float64), (0, 0), blur_px) if blur_px else image.astype(np.float64)
    noisy = sharp + np.random.default_rng(seed).normal(0, noise, image.shape)
    return np.clip(np.rint(noisy), 0, 255).astype(np.uint8)


def moved(image, length):
    kernel = np.zeros((length, length))
    kernel[length // 2] = 1 / length
    return np.rint(cv2.filter2D(image.astype(np.float64), -1, kernel)).astype(np.uint8)


@pytest.mark.parametrize("blur_px", [0.7, 1.0, 1.5, 2.0, 3.0])
@pytest.mark.parametrize("noise", [0.5, 3.0])
def test_blur_of_a_lens(blur_px, noise) -> None:
    wanted = np.hypot(blur_px, 0.35)  # the smoothed edges of the drawing
    assert edge_blur(pictured(scene(), blur_px, noise)) == pytest.approx(wanted, rel=0.15)


def test_blur_of_motion_along_one_direction() -> None:
    still, fast = (edge_blur(pictured(image)) for image in (scene(), moved(scene(), 9)))
    assert still < 1
    assert fast > 2


@pytest.mark.parametrize("image", [np.zeros((480, 640)), np.full((8, 8), 9), np.full((480, 640), 255)])
def test_nothing_to_measure(image) -> None:
    assert np.isnan(edge_blur(image.astype(np.uint8)))


def test_real_and_rendered_images_are_sharp(real_data) -> None:
    files = [
        *real_data("euroc-cam-april").glob("*.png"),
        *(real_data("rendered-camimu") / "a-aprilgrid-full" / "images").glob("*.png"),
    ]
    looks = [measure_image(cv2.imread(str(file), cv2.IMREAD_GRAYSCALE)) for file in files]
    assert len(looks) == 8
    assert all(0.4 < look.blur_px < 0.9 for look in looks)
    assert [finding.code for finding in check_looks("cam0", looks)] == ["images"]


# ---- findings ----


def looks(change=lambda image, _: image, count=10):
    return [measure_image(change(pictured(scene(seed), seed=seed), seed)) for seed in range(count)]


def codes(found):
    for finding in found:
        assert finding.severity == "good" or (finding.consequence and finding.cure)
    return {finding.code: finding.severity for finding in found}


def test_good() -> None:
    assert codes(check_looks("cam0", looks())) == {"images": "good"}
    assert check_looks("cam0", []) == []


@pytest.mark.parametrize(
    ("code", "change"),
    [
        ("motion-blur", lambda image, seed: moved(image, 11) if seed % 2 else image),
        ("out-of-focus", lambda image, _: pictured(image, 3.0)),
        ("images-bright", lambda image, _: np.where(image > 100, 255, image).astype(np.uint8)),
        ("images-dark", lambda image, _: (image // 6).astype(np.uint8)),
        ("images-flat", lambda image, _: (100 + image // 9).astype(np.uint8)),
    ],
)
def test_faults(code, change) -> None:
    assert codes(check_looks("cam0", looks(change))) == {code: "warning"}


CAMERA = Camera(
    projection="pinhole",
    intrinsics=[460, 458, 320, 240],
    distortion="none",
    distortion_coeffs=[],
    resolution=(640, 480),
)


def test_sizes() -> None:
    same = looks(count=4)
    assert check_sizes("cam0", same, CAMERA) == []
    assert check_sizes("cam0", [], CAMERA) == []
    (mixed,) = check_sizes("cam0", [*same, measure_image(scene(size=(240, 320)))], None)
    assert (mixed.severity, mixed.code) == ("problem", "image-size")
    assert "640 x 480, 320 x 240 px" in mixed.message
    (other,) = check_sizes("cam0", [measure_image(scene(size=(240, 320)))], CAMERA)
    assert (other.severity, other.code) == ("problem", "image-size")
    assert "the images are 320 x 240 px, the intrinsics are of 640 x 480 px" in other.message


def test_a_camera_that_hung() -> None:
    one = measure_image(scene())
    assert codes(check_sizes("cam0", [one] * 6, CAMERA)) == {"images-same": "warning"}
