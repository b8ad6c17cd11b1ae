"""Cameras against their equations in high precision, at their limits, and against exact and real corners."""

import gzip
from dataclasses import replace
from itertools import cycle, product

import mpmath as mp
import numpy as np
import pytest

from gnomon.errors import OptionError
from gnomon.models import lens_names
from gnomon.models.camera import Camera
from gnomon.models.distortions import arctan_over_x, first_root
from gnomon.models.target import Target

SHAPES = {
    "pinhole": [()],
    "omni": [(-0.3,), (0.8,), (1.0,), (1.9,)],
    "eucm": [(0.0, 1.0), (0.4, 1.3), (0.63, 0.9), (1.0, 1.0)],
    "ds": [(-0.27, 0.57), (0.4, 0.3), (-0.5, 0.1), (0.0, 0.7), (1.0, 0.5)],
}
COEFFS = {
    "none": [()],
    "radtan": [(-0.28340811, 0.07395907, 0.00019359, 1.76187114e-05), (-0.4, 0.1, -0.01, 0.02), (0.0, 0.0, 0.0, 0.0)],
    "radtan5": [(-0.3253, 0.1564, 8.3e-05, 1.42e-04, -0.0431), (0.1, -0.2, 0.01, 0.02, 0.3), (0.0,) * 5],
    "equidistant": [(-0.0128, 0.0026, -0.0022, 0.00022), (0.1, -0.2, 0.05, -0.01), (0.0, 0.0, 0.0, 0.0)],
    "fov": [(0.93,), (1e-3,), (2.6,), (0.199,), (0.201,)],
}
MODELS = list(product(SHAPES, COEFFS))


def test_every_model_is_in_these_tables():
    assert list(SHAPES) == list(lens_names.SHAPES)
    assert list(COEFFS) == list(lens_names.COEFFICIENTS)


def camera(projection="pinhole", distortion="none", shape=None, coeffs=None, **changed):
    shape = SHAPES[projection][-1] if shape is None else shape
    coeffs = COEFFS[distortion][0] if coeffs is None else coeffs
    fields = {
        "projection": projection,
        "intrinsics": [*shape, 458.654, 457.296, 367.215, 248.375],
        "distortion": distortion,
        "distortion_coeffs": coeffs,
        "resolution": (752, 480),
    }
    return Camera(**fields | changed)


def every(projection, distortion):
    """Return a camera for every set of parameters above."""
    return [
        camera(projection, distortion, shape, coeffs)
        for shape, coeffs in product(SHAPES[projection], COEFFS[distortion])
    ]


def reference(cam, parameters, point):
    """Return the pixel relative to the principal point's offset, by the papers' equations, in any precision."""
    x, y, z = point
    count = len(cam.intrinsics)
    *shape, fu, fv, pu, pv = parameters[:count]
    k = parameters[count:]
    if cam.projection == "pinhole":
        mx, my = x / z, y / z
    elif cam.projection == "omni":  # Mei and Rives: onto the unit sphere, shifted by xi, onto the plane
        rho = mp.sqrt(x**2 + y**2 + z**2)
        mx, my = x / rho / (z / rho + shape[0]), y / rho / (z / rho + shape[0])
    elif cam.projection == "eucm":
        alpha, beta = shape
        d = mp.sqrt(beta * (x**2 + y**2) + z**2)
        mx, my = x / (alpha * d + (1 - alpha) * z), y / (alpha * d + (1 - alpha) * z)
    else:
        assert cam.projection == "ds", f"the equation of {cam.projection} is missing here"
        xi, alpha = shape
        d1 = mp.sqrt(x**2 + y**2 + z**2)
        d2 = mp.sqrt(x**2 + y**2 + (xi * d1 + z) ** 2)
        divisor = alpha * d2 + (1 - alpha) * (xi * d1 + z)
        mx, my = x / divisor, y / divisor
    r2 = mx**2 + my**2
    r = mp.sqrt(r2)
    if cam.distortion == "none":
        dx, dy = mx, my
    elif cam.distortion in {"radtan", "radtan5"}:
        radial = 1 + k[0] * r2 + k[1] * r2**2 + (k[4] * r2**3 if len(k) > 4 else 0)
        dx = mx * radial + 2 * k[2] * mx * my + k[3] * (r2 + 2 * mx**2)
        dy = my * radial + 2 * k[3] * mx * my + k[2] * (r2 + 2 * my**2)
    else:
        if cam.distortion == "equidistant":
            theta = mp.atan(r)
            bent = theta * (1 + sum(k[n] * theta ** (2 * n + 2) for n in range(4)))
        else:
            assert cam.distortion == "fov", f"the equation of {cam.distortion} is missing here"
            bent = mp.atan(2 * r * mp.tan(k[0] / 2)) / k[0]
        scale = bent / r if r else 2 * mp.tan(k[0] / 2) / k[0] if cam.distortion == "fov" else mp.mpf(1)
        dx, dy = scale * mx, scale * my
    return fu * dx + pu, fv * dy + pv


def exact(values):
    return [mp.mpf(float(value)) for value in values]


def differences(cam, point, digits=25):
    """Return the Jacobians (2, 3) and (2, q) by central differences of the reference with a step of 10^-digits."""
    parameters, point, step = exact(cam.parameters), exact(point), mp.mpf(10) ** -digits

    def along(vector, k, call):
        moved = []
        for sign in (1, -1):
            at = list(vector)
            at[k] += sign * step
            moved.append(call(at))
        return [(high - low) / (2 * step) for high, low in zip(*moved, strict=True)]

    by_point = [along(point, k, lambda at: reference(cam, parameters, at)) for k in range(3)]
    by_parameters = [along(parameters, k, lambda at: reference(cam, at, point)) for k in range(len(parameters))]
    return np.array(by_point, dtype=float).T, np.array(by_parameters, dtype=float).T


def rim_angle(cam):
    """Return the widest angle from the optical axis that has a pixel, no more than a million pixels away."""
    low, high = 0.0, np.pi
    for _ in range(60):
        middle = 0.5 * (low + high)
        image = cam.project(np.array([[np.sin(middle), 0, np.cos(middle)]]))
        seen = image.valid[0] and abs(image.pixels[0, 0]) < 1e6
        low, high = (middle, high) if seen else (low, middle)
    return low


def sample_points(cam, rng):
    """Return points on the axis, next to it, anywhere, and close to the widest angle."""
    rim = min(rim_angle(cam), 0.95 * np.pi)
    theta = np.array([0, 1e-12, 1e-8, 1e-5, 1e-3, 0.03, 0.1, 0.3, 0.6, 0.9, 0.99, 0.9999]) * rim
    phi = rng.uniform(-np.pi, np.pi, len(theta))
    phi[:2] = 0.0
    points = np.stack([np.sin(theta) * np.cos(phi), np.sin(theta) * np.sin(phi), np.cos(theta)], axis=1)
    points[0] = 0, 0, 1
    points *= rng.uniform(0.2, 5, (len(theta), 1))
    return points[cam.project(points).valid]  # the tangential part makes the limit not quite round


@pytest.mark.parametrize(("projection", "distortion"), MODELS)
def test_values_and_every_jacobian_against_high_precision(projection, distortion):
    rng = np.random.default_rng(3)
    with mp.workdps(60):
        # Each set of parameters with at least one of the other part; all pairs would tell nothing more.
        sets = zip(*(cycle(part) for part in (SHAPES[projection], COEFFS[distortion])), range(5), strict=False)
        for shape, coeffs, _ in sets:
            cam = camera(projection, distortion, shape, coeffs)
            points = sample_points(cam, rng)
            assert len(points) >= 10
            image = cam.project(points, parameters_jacobian=True)
            for k, point in enumerate(points):
                pixel = np.array(reference(cam, exact(cam.parameters), exact(point)), dtype=float)
                np.testing.assert_allclose(image.pixels[k], pixel, rtol=1e-12, err_msg=f"{cam} {point}")
                by_point, by_parameters = differences(cam, point)
                for found, expected in ((image.by_point[k], by_point), (image.by_parameters[k], by_parameters)):
                    # relative to the largest entry of the column: one parameter, or the point
                    size = np.abs(expected).max(axis=0) if found.shape[1] != 3 else np.abs(expected).max()
                    error = np.abs(found - expected).max(axis=0)
                    assert (error <= 1e-10 * size + 1e-25).all(), (cam, point, found, expected)


def test_small_angles_across_the_threshold_of_the_series():
    squares = np.concatenate([np.geomspace(1e-300, 1e20, 600), np.linspace(0.0099, 0.0101, 41), [0.01]])
    squares = np.concatenate([squares, np.nextafter(0.01, [0, 1])])
    ratio, slope = arctan_over_x(squares)
    with mp.workdps(400):
        for k, square in enumerate(exact(squares)):
            root = mp.sqrt(square)
            expected = mp.atan(root) / root
            assert abs(ratio[k] / expected - 1) < 1e-15
            assert abs(slope[k] / ((1 / (1 + square) - expected) / (2 * square)) - 1) < 1e-13
    assert [part[0] for part in arctan_over_x(np.zeros(1))] == [1.0, -1 / 3]


@pytest.mark.parametrize("distortion", ["equidistant", "fov"])
def test_distortion_close_to_the_axis_keeps_twelve_digits(distortion):
    # Element by element, off-diagonal ones too, which vanish on the axis.
    for coeffs in COEFFS[distortion]:
        cam = camera(distortion=distortion, coeffs=coeffs, intrinsics=[1.0, 1, 0, 0])
        factor = 2 * np.tan(cam.distortion_coeffs[0] / 2) if distortion == "fov" else 1.0
        radii = np.concatenate([np.geomspace(1e-12, 1, 60), np.array([0.09999, 0.1, 0.10001]) / factor])
        points = np.stack([0.6 * radii, 0.8 * radii, np.ones_like(radii)], axis=1)
        image = cam.project(points, parameters_jacobian=True)
        with mp.workdps(80):
            for k, point in enumerate(points):
                parameters = exact(cam.parameters)
                pixel = np.array(reference(cam, parameters, exact(point)), dtype=float)
                np.testing.assert_allclose(image.pixels[k], pixel, rtol=1e-12)
                by_point, by_parameters = differences(cam, point, digits=32)
                np.testing.assert_allclose(image.by_point[k, :, :2], by_point[:, :2], rtol=2e-12, atol=1e-27)
                if not 0.4 < radii[k] < 0.6:  # the derivative by w changes its sign there
                    np.testing.assert_allclose(image.by_parameters[k], by_parameters, rtol=1e-11, atol=1e-27)


@pytest.mark.parametrize(("projection", "distortion"), MODELS)
def test_domain_is_the_widest_cone_that_is_one_to_one(projection, distortion):
    theta = np.linspace(0, np.pi, 20001)[1:]
    points = np.stack([np.sin(theta), np.zeros_like(theta), np.cos(theta)], axis=1)
    for cam in every(projection, distortion):
        image = cam.project(points)
        seen = int(np.argmin(image.valid)) if not image.valid.all() else len(theta)
        assert not image.valid[seen:].any()
        radius = image.pixels[:seen, 0]
        assert (np.diff(radius) > 0).all()
        if seen == len(theta):
            continue
        # Just outside, the equations have no pixel, or go back.
        with mp.workdps(40):
            further = [exact([mp.sin(angle), 0, mp.cos(angle)]) for angle in (theta[seen] + 1e-3, theta[seen] + 1.1e-3)]
            parameters = exact(cam.parameters)
            here, there = (reference(cam, parameters, point)[0] for point in further)
            tangential = (
                distortion.startswith("radtan") and cam.distortion_coeffs[2:].any() and cam.distortion_limit < 1e20
            )
            assert here - parameters[-len(cam.distortion_coeffs) - 2] < 0 or there < here or tangential


def test_radtan_stops_where_it_folds_back():
    cam = camera(distortion="radtan", coeffs=(-0.3, 0, 0, 0))
    assert cam.distortion_limit == pytest.approx(np.sqrt(1 / 0.9), rel=1e-14)
    rim = cam.distortion_limit
    points = np.array([[rim * (1 - 1e-9), 0, 1], [0, 2 * rim * (1 + 1e-9), 2], [5, 5, 1]])
    image = cam.project(points, parameters_jacobian=True)
    assert image.valid.tolist() == [True, False, False]
    assert np.isnan(image.pixels[1:]).all()
    assert not image.by_point[1:].any()
    assert not image.by_parameters[1:].any()
    ray, valid = cam.unproject(image.pixels[:1])
    assert valid[0]
    np.testing.assert_allclose(ray[0] / ray[0, 2], points[0], atol=1e-7)  # the fold costs half of the digits
    outside = cam.project(np.array([[rim * (1 - 1e-12), 0, 1]])).pixels + np.array([1e-3, 0])
    assert not cam.unproject(outside)[1].any()


def test_radtan_without_a_fold_has_no_limit():
    # 1 + 3 k1 s + 5 k2 s^2 has no real root: this is cam0 of EuRoC, seen up to 90 degrees
    cam = camera(distortion="radtan", coeffs=(-0.28340811, 0.07395907, 0, 0))
    assert cam.distortion_limit > 1e20
    assert cam.project(np.array([[100.0, 0, 1]])).valid[0]


def test_radtan_gains_a_third_coefficient_that_does_nothing():
    cam = camera(distortion="radtan", coeffs=(-0.3, 0.05, 0.02, -0.03))
    more = cam.with_k3()
    assert more.distortion == "radtan5"
    assert more.parameter_symbols[-1] == "k3"
    assert more.distortion_limit == pytest.approx(cam.distortion_limit, rel=1e-12)
    points = np.random.default_rng(0).normal(0, 0.3, (20, 3)) + np.array([0, 0, 1])
    np.testing.assert_allclose(more.project(points).pixels, cam.project(points).pixels, rtol=1e-14)
    fisheye = camera(distortion="equidistant")
    assert more.with_k3() is more
    assert fisheye.with_k3() is fisheye


@pytest.mark.parametrize(
    "coeffs",
    [(-0.3, 0.05, 0.02, -0.03), (0.2, -0.3, -0.05, 0.01), (0, 0, 0.1, 0.1), (-0.33, 0.16, 0.01, 0.01, -0.043)],
)
def test_radtan_with_a_tangential_part_is_one_to_one_up_to_its_limit(coeffs):
    cam = camera(distortion="radtan" if len(coeffs) == 4 else "radtan5", coeffs=coeffs)
    radius, phi = np.meshgrid(np.linspace(0, 1, 60, endpoint=False), np.linspace(0, 2 * np.pi, 90))
    points = cam.distortion_limit * (radius * np.array([np.cos(phi), np.sin(phi)])).reshape(2, -1)
    image = cam.project(np.vstack([points, np.ones(points.shape[1])]).T)
    assert image.valid.all()
    plane = image.by_point[:, :, :2] / cam.intrinsics[:2, None]
    assert np.linalg.eigvalsh(plane).min() > 0
    nearest = cam.distortion_limit * (1 - 1e-9)
    at_rim = nearest * np.array([np.cos(phi[:, 0]), np.sin(phi[:, 0])])
    rim = cam.project(np.vstack([at_rim, np.ones(len(phi))]).T).by_point[:, :, :2] / cam.intrinsics[:2, None]
    assert np.linalg.eigvalsh(rim).min() < 0.35  # and the limit is not much too cautious
    rays, valid = cam.unproject(image.pixels)
    assert valid.all()
    back = cam.project(rays)
    np.testing.assert_allclose(back.pixels, image.pixels, rtol=0, atol=1e-9)


def test_equidistant_stops_where_its_angle_turns_back():
    cam = camera(distortion="equidistant", coeffs=(-0.3, 0, 0, 0))
    theta = np.sqrt(1 / 0.9)
    assert cam.distortion_limit == pytest.approx(np.tan(theta), rel=1e-13)
    angles = theta * np.array([1 - 1e-9, 1 + 1e-9])
    image = cam.project(np.stack([np.sin(angles), 0 * angles, np.cos(angles)], axis=1))
    assert image.valid.tolist() == [True, False]


def test_polynomial_roots():
    assert first_root(np.array([-3.0, 2.0])) == pytest.approx(0.5)
    assert first_root(np.array([0.0, -1.0])) == pytest.approx(1.0)
    assert first_root(np.array([1.0, 1.0])) == np.inf
    assert first_root(np.array([0.0, 0.0])) == np.inf
    assert first_root(np.array([-1.0, 0.0, 1e-310])) == pytest.approx(1.0)
    assert first_root(np.array([-2.0, 1.0])) == pytest.approx(1.0)  # a double root


@pytest.mark.parametrize(("projection", "distortion"), MODELS)
def test_points_that_cannot_be_seen_are_blank_and_silent(projection, distortion):
    strange = [
        [0, 0, 0], [0, 0, -1], [np.nan, 0, 1], [0, np.inf, 1], [0, 0, np.inf], [1e300, 1e300, 1], [0, 0, 1e-310],
        [1, 0, 1e-300], [0, 0, -1e-300], [-np.inf, np.nan, 0], [1e-200, 0, 1e-200],
    ]  # fmt: skip
    for cam in every(projection, distortion):
        image = cam.project(np.array([*strange, [0, 0, 1.0]]), parameters_jacobian=True)
        assert not image.valid[:2].any()
        assert image.valid[-1]
        assert np.isfinite(image.pixels[image.valid]).all()
        assert np.isnan(image.pixels[~image.valid]).all()
        for jacobian in (image.by_point, image.by_parameters):
            assert np.isfinite(jacobian).all()
            assert not jacobian[~image.valid].any()
        rays, valid = cam.unproject(np.array([[np.nan, 0], [np.inf, 0], [0, -np.inf], cam.intrinsics[-2:]]))
        assert valid.tolist() == [False, False, False, True]
        assert np.isnan(rays[:3]).all()
        np.testing.assert_allclose(rays[3], [0, 0, 1], atol=1e-15)


@pytest.mark.parametrize(
    ("cam", "radius"),
    [
        (camera("omni", shape=(1.9,)), 1 / np.sqrt(1.9**2 - 1)),
        (camera("eucm", shape=(0.63, 0.9)), 1 / np.sqrt(0.9 * 0.26)),
        (camera("ds", shape=(-0.27, 0.57)), 1 / np.sqrt(0.14)),
        (camera("pinhole", "fov", coeffs=(0.93,)), np.pi / 2 / 0.93),
        (camera("pinhole", "equidistant", coeffs=(0, 0, 0, 0)), np.pi / 2),
    ],
    ids=lambda value: getattr(value, "model", ""),
)
def test_pixels_outside_the_image_of_the_domain_have_no_ray(cam, radius):
    fu, _, pu, pv = cam.intrinsics[-4:]
    pixels = np.array([[pu + fu * radius * factor, pv] for factor in (0.999, 1.001)])
    assert cam.unproject(pixels)[1].tolist() == [True, False]


def test_known_values():
    # by hand: 60 degrees off the axis
    point = np.array([[np.sqrt(3), 0, 1.0]])
    unit = {"intrinsics": [100.0, 100, 0, 0]}
    assert camera(**unit).project(point).pixels[0, 0] == pytest.approx(100 * np.sqrt(3))
    fisheye = camera(distortion="equidistant", coeffs=(0, 0, 0, 0), **unit)
    assert fisheye.project(point).pixels[0, 0] == pytest.approx(100 * np.pi / 3)
    fov = camera(distortion="fov", coeffs=(np.pi / 2,), **unit)
    assert fov.project(point).pixels[0, 0] == pytest.approx(100 * np.arctan(2 * np.sqrt(3)) * 2 / np.pi)
    omni = camera("omni", shape=(1.0,)).with_parameters([1, 100, 100, 0, 0])  # stereographic: tan(theta / 2)
    assert omni.project(point).pixels[0, 0] == pytest.approx(100 * np.tan(np.pi / 6))
    unified = camera("eucm").with_parameters([0.5, 1, 50, 50, 0, 0])  # the same: xi = alpha / (1 - alpha)
    assert unified.project(point).pixels[0, 0] == pytest.approx(100 * np.tan(np.pi / 6))
    double = camera("ds").with_parameters([0, 0.5, 50, 50, 0, 0])  # with xi = 0 too
    assert double.project(point).pixels[0, 0] == pytest.approx(100 * np.tan(np.pi / 6))
    assert double.unproject(np.array([[100 * np.tan(np.pi / 6), 0]]))[0][0] == pytest.approx(point[0] / 2)


def homography_residual(cam, board, pixels):
    """Return the distances [px] of corners (m, 2) from a plane's image, fitted to their rays: no pose is needed."""
    rays, valid = cam.unproject(pixels)
    assert valid.all()
    plane = np.column_stack([board[:, :2], np.ones(len(board))])
    zero = np.zeros_like(plane)
    rows = np.vstack([
        np.hstack([rays[:, 2:] * plane, zero, -rays[:, :1] * plane]),
        np.hstack([zero, rays[:, 2:] * plane, -rays[:, 1:2] * plane]),
    ])  # fmt: skip
    homography = np.linalg.svd(rows)[2][-1].reshape(3, 3)
    points = plane @ homography.T
    points *= np.sign((points * rays).sum(axis=1))[:, None]
    return np.linalg.norm(cam.project(points).pixels - pixels, axis=1)


@pytest.mark.parametrize("folder", ["a-aprilgrid-full", "d-checkerboard-ideal-imu"])
def test_rays_of_exact_projections_are_those_of_a_plane(real_data, folder):
    corners = np.loadtxt(real_data(f"rendered-camimu/{folder}/images/true_corners.csv"), delimiter=",")
    cam = camera(
        distortion="radtan",
        coeffs=(-0.28, 0.075, 0.0002, -0.00015),
        intrinsics=[460.0, 458.5, 322.4, 237.1],
        resolution=(640, 480),
    )
    for stamp in np.unique(corners[:, 0]):
        view = corners[corners[:, 0] == stamp]
        assert homography_residual(cam, view[:, 4:], view[:, 2:4]).max() < 2e-5  # written with six decimals


def test_real_corners_are_those_of_the_board(real_data):
    # EuRoC cam0 with its published intrinsics: a wrong lens or a wrong order of corners costs tens of pixels.
    board = Target.aprilgrid(tag_cols=6, tag_rows=6, tag_size_m=0.088, tag_spacing=0.3)
    cam = camera(distortion="radtan")
    with gzip.open(real_data("euroc-imu-april/cam0_corners.csv.gz"), "rt") as stream:
        rows = [next(stream) for _ in range(20000)][1:]
    table = np.array([row.split(",") for row in rows], dtype=float)
    _, first = np.unique(table[:, 0], return_index=True)
    residuals = []
    for view in np.split(table, first[1:-1])[:-1:15]:
        point = board.point_of_tag_corner(view[:, 1], view[:, 2])
        residuals.append(homography_residual(cam, board.points[point], view[:, 3:]))
    assert len(residuals) >= 5
    assert np.median(np.concatenate(residuals)) < 0.5


def test_parameters_and_their_names():
    cam = camera("ds", "fov", shape=(-0.2, 0.6), coeffs=(0.9,))
    assert cam.model == "ds-fov"
    assert cam.parameters.tolist() == [-0.2, 0.6, 458.654, 457.296, 367.215, 248.375, 0.9]
    assert cam.parameter_names == (*(f"intrinsics[{k}]" for k in range(6)), "distortion_coeffs[0]")
    assert cam.parameter_symbols == ("xi", "alpha", "fu", "fv", "pu", "pv", "w")
    kinds = ("projection", "projection", "focal", "focal", "principal", "principal", "distortion")
    assert cam.parameter_kinds == kinds
    moved = replace(cam, line_delay_s=1e-5, topic="/cam0").with_parameters(cam.parameters + 0.01)
    np.testing.assert_array_equal(moved.parameters, cam.parameters + 0.01)
    assert (moved.line_delay_s, moved.topic, moved.resolution) == (1e-5, "/cam0", (752, 480))
    with pytest.raises(ValueError, match="read-only"):
        moved.intrinsics[0] = 0


def test_the_limit_follows_the_coefficients():
    cam = camera(distortion="radtan", coeffs=(-0.3, 0, 0, 0))
    wider = cam.with_parameters([*cam.intrinsics, -0.1, 0, 0, 0])
    assert wider.distortion_limit == pytest.approx(np.sqrt(1 / 0.3))


def test_arrays_are_stored_component_by_component():
    cam = camera("ds", "radtan")
    rng = np.random.default_rng(0)
    points = rng.normal((0, 0, 2), size=(20001, 3))  # more than a block, and not a multiple of it
    image = cam.project(points, parameters_jacobian=True)
    assert image.pixels.shape == (20001, 2)
    assert image.by_point.shape == (20001, 2, 3)
    assert image.by_parameters.shape == (20001, 2, 10)
    assert image.pixels[:, 1].flags.c_contiguous
    assert image.by_point[:, 1, 2].flags.c_contiguous
    assert image.by_parameters[:, 0, 4].flags.c_contiguous
    for start in (0, 8191, 8192, 20000):
        one = cam.project(np.asfortranarray(points[start : start + 1]), parameters_jacobian=True)
        np.testing.assert_array_equal(one.pixels[0], image.pixels[start])
        np.testing.assert_array_equal(one.by_point[0], image.by_point[start])
        np.testing.assert_array_equal(one.by_parameters[0], image.by_parameters[start])


def test_derivatives_only_where_asked_for():
    cam = camera("eucm", "equidistant")
    points = np.array([[0.1, 0.2, 1.0]])
    plain = cam.project(points, point_jacobian=False)
    assert plain.by_point is None
    assert plain.by_parameters is None
    only = cam.project(points, point_jacobian=False, parameters_jacobian=True)
    both = cam.project(points, parameters_jacobian=True)
    assert only.by_point is None
    np.testing.assert_array_equal(only.by_parameters, both.by_parameters)
    np.testing.assert_array_equal(plain.pixels, both.pixels)


def test_no_points_and_no_pixels():
    cam = camera("omni", "radtan")
    image = cam.project(np.empty((0, 3)), parameters_jacobian=True)
    assert image.pixels.shape == (0, 2)
    assert image.by_point.shape == (0, 2, 3)
    assert image.by_parameters.shape == (0, 2, 9)
    rays, valid = cam.unproject(np.empty((0, 2)))
    assert rays.shape == (0, 3)
    assert valid.shape == (0,)
    with pytest.raises(OptionError, match=r"points must be \(n, 3\); found \(3,\)"):
        cam.project(np.zeros(3))
    with pytest.raises(OptionError, match=r"pixels must be \(n, 2\); found \(4, 3\)"):
        cam.unproject(np.zeros((4, 3)))


@pytest.mark.parametrize(
    ("changed", "message"),
    [
        ({"projection": "fisheye"}, "no projection 'fisheye'; it must be one of pinhole, omni, eucm, ds"),
        ({"distortion": "equi"}, "no distortion 'equi'; it must be one of none, radtan, radtan5, equidistant, fov"),
        ({"intrinsics": [1, 2, 3]}, r"pinhole takes 4 intrinsics \(fu fv pu pv\); found 3"),
        ({"projection": "ds"}, r"ds takes 6 intrinsics \(xi alpha fu fv pu pv\); found 4"),
        ({"intrinsics": ["a", 1, 2, 3]}, "intrinsics of pinhole must be numbers"),
        ({"intrinsics": [460, -3, 320, 240]}, "focal length fv -3 must be greater than zero"),
        ({"intrinsics": [0, 460, 320, 240]}, "focal length fu 0 must be greater than zero"),
        ({"intrinsics": [460, 460, np.nan, 240]}, "pu of pinhole is nan; it must be a finite number"),
        ({"distortion_coeffs": [0.1]}, "none takes 0 distortion_coeffs; found 1"),
        ({"distortion": "radtan", "distortion_coeffs": [0.1]}, r"radtan takes 4 .*\(k1 k2 p1 p2\); found 1"),
        ({"distortion": "fov", "distortion_coeffs": [0]}, "w 0 is out of range"),
        ({"distortion": "fov", "distortion_coeffs": [3.2]}, "w 3.2 is out of range"),
        ({"projection": "omni", "intrinsics": [-1, 1, 1, 0, 0]}, "xi -1 is out of range: it must be greater than -1"),
        ({"projection": "eucm", "intrinsics": [1.1, 1, 1, 1, 0, 0]}, "alpha 1.1 is out of range: .* from 0 to 1"),
        ({"projection": "eucm", "intrinsics": [0.5, 0, 1, 1, 0, 0]}, "beta 0 is out of range"),
        ({"projection": "ds", "intrinsics": [1.2, 0.5, 1, 1, 0, 0]}, "xi 1.2 is out of range"),
        ({"projection": "ds", "intrinsics": [0.2, -0.5, 1, 1, 0, 0]}, "alpha -0.5 is out of range"),
        ({"resolution": (640, 0)}, r"resolution must be .*; found \[640, 0\]"),
        ({"resolution": (640.5, 480)}, "resolution must be width and height"),
        ({"resolution": (640,)}, "resolution must be width and height"),
        ({"line_delay_s": np.inf}, "line_delay_s inf must be a finite number"),
    ],
)
def test_cameras_that_make_no_sense_are_refused(changed, message):
    pinhole = {"projection": "pinhole", "intrinsics": [460, 458, 320, 240], "resolution": (640, 480)}
    with pytest.raises(OptionError, match=message):
        Camera(**pinhole | {"distortion": "none", "distortion_coeffs": []} | changed)


def test_other_parameters_are_checked_too():
    cam = camera("eucm", shape=(0.6, 1.1))
    with pytest.raises(OptionError, match=r"eucm-none takes 6 parameters \(alpha beta fu fv pu pv\); found 5"):
        cam.with_parameters(cam.parameters[:5])
    with pytest.raises(OptionError, match=r"alpha 1\.6 is out of range"):
        cam.with_parameters(cam.parameters + 1)
