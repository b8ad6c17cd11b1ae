"""The fit of corners, against pictures that are blurred numerically."""

import cv2
import numpy as np
import pytest

from gnomon.detect.boards.corner_fit import _crossing_or_tip, fit_corners

FINE = 11  # points along a pixel in which pictures are blurred
SIDE = 41  # px


def picture(kind, centre, along, blur, *, black=40.0, white=200.0, across=0.0, bent=(0.0, 0.0)):
    """Return a picture, SIDE x SIDE, of edges that leave `centre` into the directions `along`, [rad], blurred by Gauss.

    The blur is wider by `across` in the direction of 45 degrees. Edges bend into the black by curvatures `bent` [1/px].
    """
    at = (np.arange(SIDE * FINE) + 0.5) / FINE - 0.5
    dx, dy = np.meshgrid(at - centre[0], at - centre[1])
    sides = []
    for one, other in ((0, 1), (1, 0)):
        inwards = np.sign(np.sin(along[other] - along[one])) * (np.cos(along[one]) * dy - np.sin(along[one]) * dx)
        inwards -= 0.5 * bent[one] * (np.cos(along[one]) * dx + np.sin(along[one]) * dy) ** 2
        sides.append(np.clip(inwards * FINE + 0.5, 0, 1))  # share of the cell that is beyond the edge
    dark = sides[0] * sides[1]
    if kind == "crossing":
        dark += (1 - sides[0]) * (1 - sides[1])
    sharp = (white + (black - white) * dark).astype(np.float32)
    soft = cv2.GaussianBlur(sharp, (0, 0), blur * FINE, borderType=cv2.BORDER_REPLICATE)
    if across:
        half = int(4 * across * FINE)
        i, j = np.mgrid[-half : half + 1, -half : half + 1]
        narrow = 0.5
        kernel = np.exp(-0.5 * (((i + j) / np.sqrt(2) / (across * FINE)) ** 2 + ((i - j) / np.sqrt(2) / narrow) ** 2))
        soft = cv2.filter2D(soft, -1, kernel / kernel.sum(), borderType=cv2.BORDER_REPLICATE)
    return soft[FINE // 2 :: FINE, FINE // 2 :: FINE]


def grey(image, rng=None, noise=0.0):
    noisy = image + (rng.normal(0, noise, image.shape) if rng is not None else 0)
    return np.clip(np.rint(noisy), 0, 255).astype(np.uint8)


def fitted(image, centre, along, kind, **shape):
    edges = np.array([[[np.cos(a), np.sin(a)] for a in along]])
    return fit_corners(image, np.array([centre], float), edges, shape.pop("radius", 4.5), kind, **shape)


@pytest.mark.parametrize("kind", ["crossing", "tip"])
@pytest.mark.parametrize("angle", [60, 90, 125])
def test_the_model_is_what_a_blur_makes_of_the_picture(kind, angle):
    centre, along, blur = np.array([20.3, 19.6]), np.radians([10, 10 + angle]), 1.1
    seen = picture(kind, centre, along, blur, black=0, white=1)
    x, y = np.meshgrid(np.arange(SIDE) - centre[0], np.arange(SIDE) - centre[1])
    normals = along + (np.pi / 2) * np.array([1, -1])
    a = np.stack([(np.cos(n) * x + np.sin(n) * y).ravel() / blur for n in normals])[None].astype(np.float32)
    rho = np.array([[np.cos(normals[0] - normals[1])]], np.float32)
    model = 0.5 - 0.5 * _crossing_or_tip(a, rho, kind)[0].reshape(SIDE, SIDE)
    # what is left are the higher powers of the correlation
    assert np.abs(model - seen)[8:-8, 8:-8].max() < 0.003 + 0.2 * abs(rho[0, 0]) ** 3


@pytest.mark.parametrize("kind", ["crossing", "tip"])
def test_corners_without_noise_are_found_to_a_two_hundredth_of_a_pixel(kind):
    rng = np.random.default_rng(3)
    for _ in range(12):
        centre, first = 20 + rng.uniform(-0.5, 0.5, 2), rng.uniform(0, 2 * np.pi)
        along = np.array([first, first + rng.choice([-1, 1]) * np.radians(rng.uniform(65, 115))])
        blur = rng.uniform(0.6, 1.4)
        image = grey(picture(kind, centre, along, blur))
        fit = fitted(image, centre + rng.uniform(-1, 1, 2), along + rng.normal(0, 0.05, 2), kind, arm=9)
        assert fit.good[0]
        np.testing.assert_allclose(fit.pixels[0], centre, atol=0.005 if kind == "crossing" else 0.02)
        assert fit.blur_px[0] == pytest.approx(blur, abs=0.05)
        assert fit.black[0] == pytest.approx(40, abs=3)
        assert fit.white[0] == pytest.approx(200, abs=3)


@pytest.mark.parametrize("kind", ["crossing", "tip"])
def test_errors_are_what_sigma_says(kind):
    rng = np.random.default_rng(4)
    centre, along = np.array([20.2, 19.7]), np.radians([25, 110])
    clean = picture(kind, centre, along, 0.8)
    for noise in (2.0, 8.0):
        fits = [
            fitted(grey(clean, rng, noise), centre + rng.uniform(-0.5, 0.5, 2), along, kind, arm=9) for _ in range(60)
        ]
        assert all(fit.good[0] for fit in fits)
        z = np.array([(fit.pixels[0] - centre) / fit.sigma_px[0] for fit in fits])
        assert 0.75 < np.sqrt((z**2).mean()) < 1.25
        assert np.abs(z.mean(axis=0)).max() < 0.5


@pytest.mark.parametrize("kind", ["crossing", "tip"])
@pytest.mark.parametrize("bent", [(0.002, 0.0), (0.0, 0.002), (-0.001, 0.002)])
def test_the_fit_says_what_a_bent_edge_does_to_it(kind, bent):
    along, moved, told = np.radians([20, 105]), [], []
    for centre in 20 + np.random.default_rng(5).uniform(-0.5, 0.5, (16, 2)):  # grey levels are whole numbers
        straight, seen = (
            fitted(grey(picture(kind, centre, along, 0.7, black=5, white=250, bent=bend)), centre, along, kind, arm=9)
            for bend in ((0.0, 0.0), bent)
        )
        moved.append(seen.pixels[0] - straight.pixels[0])
        told.append(seen.bow[0] @ bent)
    moved, told = np.mean(moved, axis=0), np.mean(told, axis=0)
    assert np.linalg.norm(moved) > 0.004
    assert np.linalg.norm(told - moved) < 0.15 * np.linalg.norm(moved)


def test_the_blur_of_a_motion_does_not_move_a_crossing():
    centre, along = np.array([20.3, 19.8]), np.radians([5, 95])
    fit = fitted(grey(picture("crossing", centre, along, 0.6, across=1.2)), centre + 0.5, along, "crossing")
    assert fit.good[0]
    np.testing.assert_allclose(fit.pixels[0], centre, atol=0.01)
    assert fit.misfit[0] < 0.02  # one blur for both edges without their correlation leaves 0.05


@pytest.mark.parametrize("kind", ["crossing", "tip"])
def test_saturated_pixels_do_not_move_corners(kind):
    centre, along = np.array([20.3, 19.8]), np.radians([35, 120])
    image = grey(picture(kind, centre, along, 0.9, black=30, white=340))
    assert (image == 255).mean() > 0.3
    fit = fitted(image, centre + np.array([0.6, -0.4]), along, kind, arm=9)
    assert fit.good[0]
    np.testing.assert_allclose(fit.pixels[0], centre, atol=0.01 if kind == "crossing" else 0.03)
    assert fit.white[0] > 300  # a fit that took them for what they look like says 256


def test_what_is_no_corner_is_not_good():
    along = np.radians([0, 90])
    step = np.where(np.arange(SIDE) < 20, 30, 220).astype(np.uint8)
    pictures = {
        "flat": np.full((SIDE, SIDE), 90, np.uint8),
        "edge": np.tile(step, (SIDE, 1)),
        "noise": np.random.default_rng(1).integers(0, 255, (SIDE, SIDE)).astype(np.uint8),
        "turned by 45 degrees": grey(picture("crossing", [20, 20], np.radians([45, 135]), 0.8))[::-1],
    }
    for name, image in pictures.items():
        fit = fitted(image, [20, 20], along, "crossing")
        assert not fit.good[0] or name == "turned by 45 degrees", name
    far = fitted(grey(picture("crossing", [24.5, 20], along, 0.8)), [20, 20], along, "crossing")
    assert not far.good[0]


def test_corners_outside_the_image_are_no_good_and_those_at_its_border_are_fitted():
    along = np.radians([0, 90])
    image = grey(picture("crossing", [3.2, 20.4], along, 0.8))
    edges = np.tile([[[1.0, 0], [0, 1]]], (4, 1, 1))
    guess = np.array([[3.0, 20.0], [-0.4, 20.0], [500.0, 20.0], [np.nan, 3.0]])
    fit = fit_corners(image, guess, edges, 4.5)
    assert fit.good.tolist() == [True, False, False, False]
    np.testing.assert_allclose(fit.pixels[0], [3.2, 20.4], atol=0.01)


def test_images_smaller_than_the_window_and_no_corners_at_all():
    edges = np.array([[[1.0, 0], [0, 1]]])
    for shape in ((1, 1), (3, 8), (8, 3)):
        assert not fit_corners(np.zeros(shape, np.uint8), np.array([[1.0, 1.0]]), edges, 4.5).good.any()
    assert len(fit_corners(np.zeros((50, 50), np.uint8), np.empty((0, 2)), np.empty((0, 2, 2)), 4.5)) == 0


def test_a_view_of_a_larger_array_is_fitted_as_its_copy_is():
    along = np.radians([20, 115])
    image = grey(picture("crossing", [20.3, 19.8], along, 0.8))
    larger = np.zeros((2 * SIDE, 3 * SIDE), np.uint8)
    larger[::2, ::3] = image
    one, other = (fitted(each, [20.0, 20.0], along, "crossing") for each in (image, larger[::2, ::3]))
    np.testing.assert_array_equal(one.pixels, other.pixels)


def test_each_corner_is_fitted_for_itself():
    along = np.radians([20, 115])
    image = grey(picture("crossing", [20.3, 19.8], along, 0.8), np.random.default_rng(2), 2.0)
    edges = np.tile([[[np.cos(a), np.sin(a)] for a in along]], (3, 1, 1))
    alone = fit_corners(image, np.array([[20.0, 20.0]]), edges[:1], 4.5)
    among = fit_corners(image, np.array([[5.0, 5.0], [20.0, 20.0], [30.0, 8.0]]), edges, np.array([2.0, 4.5, 3.0]))
    np.testing.assert_allclose(among.pixels[1], alone.pixels[0], atol=1e-6)
