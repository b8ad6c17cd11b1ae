"""What every camera must obey, whatever its parameters."""

import numpy as np
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from gnomon.models.camera import Camera

unit = st.floats(0, 1)


def between(low, high):
    return st.floats(low, high)


SHAPES = {
    "pinhole": st.tuples(),
    "omni": st.tuples(between(-0.9, 3)),
    "eucm": st.tuples(unit, between(0.3, 3)),
    "ds": st.tuples(between(-0.9, 1), unit),
}
COEFFS = {
    "none": st.tuples(),
    "radtan": st.tuples(*[between(-0.4, 0.4)] * 2, *[between(-0.02, 0.02)] * 2),
    "radtan5": st.tuples(*[between(-0.4, 0.4)] * 2, *[between(-0.02, 0.02)] * 2, between(-0.2, 0.2)),
    "equidistant": st.tuples(*[between(-0.2, 0.2)] * 4),
    "fov": st.tuples(between(1e-3, 2.8)),
}


@st.composite
def cameras(draw):
    projection, distortion = draw(st.sampled_from(sorted(SHAPES))), draw(st.sampled_from(sorted(COEFFS)))
    focal = draw(between(50, 2000))
    return Camera(
        projection=projection,
        intrinsics=[*draw(SHAPES[projection]), focal, focal * draw(between(0.9, 1.1)), 320.5, 241.0],
        distortion=distortion,
        distortion_coeffs=draw(COEFFS[distortion]),
        resolution=(640, 480),
    )


directions = st.tuples(between(0, np.pi), between(-np.pi, np.pi)).map(
    lambda a: np.array([np.sin(a[0]) * np.cos(a[1]), np.sin(a[0]) * np.sin(a[1]), np.cos(a[0])])
)
steady = settings(deadline=None, max_examples=200)


def seen(cam, point):
    """Return the image of a point that is well inside the domain, where a pixel tells its ray."""
    image = cam.project(point[None])
    assume(image.valid[0])
    sensitivity = np.linalg.svd(image.by_point[0], compute_uv=False)[-1]
    assume(sensitivity > 1e-4 * cam.intrinsics[-4])
    return image, sensitivity


@steady
@given(cam=cameras(), ray=directions, distance=between(0.01, 100))
def test_a_ray_comes_back_from_its_pixel(cam, ray, distance):
    image, sensitivity = seen(cam, distance * ray)
    found, valid = cam.unproject(image.pixels)
    assert valid[0]
    # What the rounding of the pixel costs, and not more.
    rounding = np.finfo(float).eps * (np.abs(image.pixels).max() + 320)
    assert np.linalg.norm(found[0] - ray) <= 1e-12 + 32 * rounding / (sensitivity * distance)


@steady
@given(cam=cameras(), u=between(-3000, 3000), v=between(-3000, 3000))
def test_a_pixel_comes_back_from_its_ray(cam, u, v):
    rays, valid = cam.unproject(np.array([[u, v]]))
    assume(valid[0])
    np.testing.assert_allclose(np.linalg.norm(rays[0]), 1, rtol=1e-14)
    image = cam.project(rays)
    assume(image.valid[0])  # on the rim of the domain itself, rounding decides
    gain = np.abs(image.by_point[0]).max()
    assert np.abs(image.pixels[0] - [u, v]).max() <= 1e-9 + 1e-14 * gain


@steady
@given(cam=cameras(), u=between(-3000, 3000), v=between(-3000, 3000))
def test_a_ray_is_inside_the_domain(cam, u, v):
    rays, valid = cam.unproject(np.array([[u, v]]))
    assume(valid[0])
    inwards = rays[0] + [0, 0, 1e-7]
    assert cam.project(inwards[None]).valid[0]


@steady
@given(cam=cameras(), ray=directions, distance=between(0.01, 100), factor=between(0.01, 100))
def test_distance_changes_nothing(cam, ray, distance, factor):
    near, _ = seen(cam, distance * ray)
    far = cam.project(factor * distance * ray[None], parameters_jacobian=True)
    assume(far.valid[0])
    size = np.abs(near.by_point).max() * distance
    np.testing.assert_allclose(far.pixels, near.pixels, rtol=1e-13, atol=1e-13 * size)
    np.testing.assert_allclose(far.by_point * factor, near.by_point, rtol=0, atol=1e-10 * size / distance)
    along = near.by_point[0] @ (distance * ray)  # Euler: homogeneous of degree zero
    assert np.abs(along).max() <= 1e-12 * size


@steady
@given(cam=cameras(), ray=directions, turn=between(-np.pi, np.pi))
def test_lenses_without_a_tangential_part_are_round(cam, ray, turn):
    assume(not cam.distortion.startswith("radtan") or not cam.distortion_coeffs[2:4].any())
    cam = cam.with_parameters([*cam.intrinsics[:-4], 300, 300, 0, 0, *cam.distortion_coeffs])
    image, _ = seen(cam, ray)
    rotation = np.array([[np.cos(turn), -np.sin(turn), 0], [np.sin(turn), np.cos(turn), 0], [0, 0, 1]])
    turned = cam.project((rotation @ ray)[None])
    assume(turned.valid[0])
    size = np.abs(image.by_point).max()
    np.testing.assert_allclose(turned.pixels[0], rotation[:2, :2] @ image.pixels[0], rtol=0, atol=1e-13 * size)
    expected = rotation[:2, :2] @ image.by_point[0] @ rotation.T
    np.testing.assert_allclose(turned.by_point[0], expected, rtol=0, atol=1e-10 * size)
