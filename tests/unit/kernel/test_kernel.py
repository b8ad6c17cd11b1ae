"""The compiled kernel gives what NumPy gives; without it, or with another one, NumPy does the work."""

import io
import shutil
import subprocess
import sys
from pathlib import Path

import cv2
import numpy as np
import orjson
import pytest

from camera_imu_problem import problem
from gnomon import kernel
from gnomon.detect.boards.corner_fit import fit_corners
from gnomon.detect.boards.tag_places import fit_homography, map_points
from gnomon.estimate.allan.deviation import overlapping_allan
from gnomon.estimate.camera_imu.batch import linearize_batch
from gnomon.estimate.camera_imu.terms.board_terms import CornerProducts
from gnomon.estimate.camera_imu.terms.visual_terms import CornerNoise, Exposures, corner_sums
from gnomon.estimate.multiposition.measurements import MotionSegments, integrate_rates
from gnomon.geometry.rotations import rotation_from_rotvec
from gnomon.models.camera import Camera
from gnomon.models.lens_names import COEFFICIENTS, SHAPES
from gnomon.writers.apply import _lines, join_columns

ROOT = Path(__file__).parents[3]
compiled = pytest.mark.skipif(kernel.load_kernel() is None, reason="the kernel was not compiled")

PROBLEMS = {
    "two lenses": {},
    "rolling shutter": {"rolling": True},
    "board": {"board": 12, "flat": False},
    "board and rolling shutter": {"board": 12, "rolling": True},
    "two IMUs": {"imus": 2, "segments": 2},
    "triads apart": {"imus": 2, "apart": True, "order": 6},
    "hardly turned": {"length": 1e-4, "order": 4},
    "turned by half a radian": {"length": 0.5},
    "turned far": {"length": 4.0, "huber": np.inf},
    "all omni": {"models": (("omni", "radtan5"), ("eucm", "equidistant"))},
}


def equations(given):
    """Return all that a linearisation says, name -> array; sums on the board's corners too."""
    lin = linearize_batch(given.measurements, given.state, given.layout, given.noise, probing=True)
    system = lin.system
    found = {f"band {g} {h}": part for g, row in enumerate(system.band) for h, part in enumerate(row)}
    found |= {"tail": system.tail, "corner": system.corner, "corner_rhs": system.corner_rhs}
    found |= {"cost": np.array(lin.cost), "chi2": np.array(lin.inertial_chi2)}
    if system.wide is not None:
        found["wide"] = system.wide.blocks(0, len(system.tail))
    for number, sums in enumerate(lin.sums):
        known = lin.known[number]
        of_exposure = (sums.gram, sums.cost, sums.mean_square, sums.valid)
        found |= {f"exposure {number} {i}": values[known].copy() for i, values in enumerate(of_exposure)}
        found |= {f"corner {number}": np.column_stack([sums.residual, sums.weight, sums.corner_cost])}
    return found


@compiled
@pytest.mark.parametrize("name", PROBLEMS)
def test_the_kernel_gives_what_numpy_gives(name, monkeypatch):
    given = problem(**PROBLEMS[name], seed=3)
    monkeypatch.delenv("GNOMON_KERNEL", raising=False)
    fast = equations(given)
    monkeypatch.setenv("GNOMON_KERNEL", "0")
    plain = equations(given)
    assert fast.keys() == plain.keys()
    for key, values in plain.items():
        sizes = np.abs(values[np.isfinite(values)]).max(initial=0.0)
        np.testing.assert_allclose(fast[key], values, rtol=1e-12, atol=1e-12 * sizes, err_msg=key)


@compiled
@pytest.mark.parametrize("distortion", COEFFICIENTS)
@pytest.mark.parametrize("projection", SHAPES)
def test_corners_of_every_lens_are_summed_up_as_by_numpy(projection, distortion, monkeypatch):
    """Near the axis and beyond where it images anything, with a shape of the board and the offset of each corner."""
    rng = np.random.default_rng(7)
    shape = [0.3, 1.2][: len(SHAPES[projection])] if projection == "eucm" else [-0.2, 0.6][: len(SHAPES[projection])]
    coeffs = [0.9] if distortion == "fov" else [-0.1, 0.02, 1e-3, -2e-3, 5e-3][: len(COEFFICIENTS[distortion])]
    camera = Camera(
        projection=projection,
        intrinsics=[*shape, 460, 455, 370, 240],
        distortion=distortion,
        distortion_coeffs=coeffs,
        resolution=(752, 480),
    )
    start = np.array([0, 40, 41, 41, 200])
    points = rng.normal(0, 0.3, (start[-1], 3)) * [1, 1, 0.1]
    R = rotation_from_rotvec(rng.normal(0, [[0.1], [0.1], [0.1], [2.0]], (4, 3)))
    p = np.array([[0, 0, 0.5], [1e-4, 0, 0.6], [0, 0, 1], [0.1, 0, 0.2]])
    points[40] = 0.0  # near the axis
    exposures = Exposures(
        frame=np.arange(4),
        start=start,
        points=points,
        pixels=rng.uniform(0, 700, (start[-1], 2)),
        delay_rows=np.zeros(4),
        spread=rng.uniform(0.5, 2, start[-1]),
    )
    noise = CornerNoise(sigma_px=100.0, huber=2.0, probe_sign=rng.choice([-1.0, 1.0], (start[-1], 2)))
    found = []
    for switch in ("1", "0"):
        monkeypatch.setenv("GNOMON_KERNEL", switch)
        products = CornerProducts(np.arange(start[-1]) % 50, rng.random(start[-1]) >= 0, 50, len(camera.parameters) + 5)
        sums = corner_sums(
            exposures,
            camera,
            R,
            p,
            noise,
            own_parameters=np.arange(len(camera.parameters)),
            target_scale=1.1,
            scale_column=True,
            shape=np.stack([points**2, points[:, ::-1]]),
            offsets=products,
        )
        whole = (sums.sums, sums.cost, sums.mean_square, sums.valid, sums.residual, sums.weight, sums.corner_cost)
        found.append((*whole, products.by_twist, products.rest, products.squares))
    assert 0 < found[1][3].sum() <= start[-1]
    for fast, plain in zip(*found, strict=True):
        sizes = np.abs(plain[np.isfinite(plain)]).max(initial=0.0)
        np.testing.assert_allclose(fast, plain, rtol=1e-12, atol=1e-12 * sizes)


@compiled
@pytest.mark.parametrize("samples", [9, 5000, 40_000, 300_001])
def test_allan_variances_are_those_of_numpy(samples, monkeypatch):
    rng = np.random.default_rng(5)
    values = np.cumsum(rng.normal(0.0, 1e-2, (samples, 3)), axis=0) + rng.normal([1.0, -20.0, 0.0], 0.1, (samples, 3))
    found = []
    for switch in ("1", "0"):
        monkeypatch.setenv("GNOMON_KERNEL", switch)
        found.append(overlapping_allan(values, 100.0))
    fast, plain = found
    np.testing.assert_allclose(fast.variance, plain.variance, rtol=1e-12)
    np.testing.assert_allclose(fast.straight, plain.straight, rtol=1e-9)
    np.testing.assert_allclose(fast.slope, plain.slope, rtol=1e-9)


@compiled
@pytest.mark.parametrize("sensitive", [True, False])
def test_rotations_are_those_of_numpy(sensitive, monkeypatch):
    rng = np.random.default_rng(6)
    lengths = np.array([40, 1, 2, 300])
    n = lengths.sum()
    dt_s = rng.uniform(0.005, 0.015, n)
    dt_s[np.cumsum(lengths) - 1] = 0.0
    regressors = np.concatenate([rng.normal(0, 3, (n, 3)), np.ones((n, 1)), rng.normal(0, 9, (n, 3))], axis=1)
    segments = MotionSegments(gyroscope=regressors[:, :3], accelerometer=regressors[:, 4:], dt_s=dt_s, lengths=lengths)
    found = []
    for switch in ("1", "0"):
        monkeypatch.setenv("GNOMON_KERNEL", switch)
        found.append(integrate_rates(segments, regressors[:, :3], regressors if sensitive else None))
    fast, plain = found
    np.testing.assert_allclose(fast.rotation, plain.rotation, rtol=0, atol=1e-12)
    np.testing.assert_allclose(fast.sensitivity, plain.sensitivity, rtol=1e-12, atol=1e-12)
    assert sensitive == fast.sensitivity.any()


@compiled
@pytest.mark.parametrize("white", [180, 320])
@pytest.mark.parametrize("kind", ["crossing", "tip"])
def test_corners_are_fitted_as_by_numpy(kind, white, monkeypatch):
    """To what single precision leaves of a pixel, a thousandth of a standard deviation."""
    rng = np.random.default_rng(8)
    side, period, blur = 400, 40, 1.1
    x, y = np.meshgrid(*[np.arange(side, dtype=float)] * 2)
    p, q = (np.sin(np.pi * (a + 0.1 * b) / period) for a, b in ((x, y), (y, -x)))
    dark = p * q > 0 if kind == "crossing" else (p > 0) & (q > 0)
    sharp = np.where(dark, 30.0, white).astype(np.float32)
    image = np.clip(cv2.GaussianBlur(sharp, (0, 0), blur) + rng.normal(0, 2, sharp.shape), 0, 255).astype(np.uint8)
    k, m = (grid.ravel() for grid in np.meshgrid(np.arange(1, 8), np.arange(1, 8)))
    places = np.linalg.solve([[1, 0.1], [-0.1, 1]], period * np.stack([k, m])).T
    upper = np.where((k + m) % 2 == 0, 1.0, -1.0) if kind == "crossing" else np.where(k % 2 == 0, 1.0, -1.0)
    lower = np.ones(len(k)) if kind == "crossing" else np.where(m % 2 == 0, 1.0, -1.0)
    edges = np.stack([upper[:, None] * [0.995, 0.0995], lower[:, None] * [-0.0995, 0.995]], axis=1)
    guess = places + rng.uniform(-0.7, 0.7, places.shape)
    monkeypatch.delenv("GNOMON_KERNEL", raising=False)
    fast = fit_corners(image, guess, edges, 4.5, kind, arm=9.0)
    monkeypatch.setenv("GNOMON_KERNEL", "0")
    plain = fit_corners(image, guess, edges, 4.5, kind, arm=9.0)
    assert plain.good.mean() > 0.7
    np.testing.assert_array_equal(fast.good, plain.good)
    tolerances = {"pixels": 5e-5, "sigma_px": 5e-5, "blur_px": 5e-5, "normals": 5e-5, "bow": 1e-3, "slope": 1e-3}
    for field, tolerance in tolerances.items():
        one, other = (getattr(fits, field)[plain.good] for fits in (fast, plain))
        np.testing.assert_allclose(one, other, rtol=1e-4, atol=tolerance, err_msg=field)


@compiled
@pytest.mark.parametrize("noise", [0.0, 1e-3, 1e-2])
def test_homographies_are_those_of_numpy(noise, monkeypatch):
    rng = np.random.default_rng(4)
    for turn in np.linspace(0, 2 * np.pi, 12):
        points = rng.uniform(0, 0.4, (int(rng.integers(5, 150)), 2))
        H = np.array([[np.cos(turn), -np.sin(turn), 1], [np.sin(turn), np.cos(turn), 2], [0.3, -0.2, 1.0]])
        seen = np.column_stack([points, np.ones(len(points))]) @ H.T
        pixels = seen[:, :2] / seen[:, 2:]
        pixels += rng.normal(0, noise * np.ptp(pixels), pixels.shape)
        monkeypatch.delenv("GNOMON_KERNEL", raising=False)
        fast = map_points(fit_homography(points, pixels)[None], points)[0]
        monkeypatch.setenv("GNOMON_KERNEL", "0")
        plain = map_points(fit_homography(points, pixels)[None], points)[0]
        np.testing.assert_allclose(fast, plain, atol=1e-12 * np.abs(pixels).max())


@compiled
@pytest.mark.parametrize("columns", [1, 3, 9])
def test_lines_of_a_table_are_those_of_python(columns):
    rng = np.random.default_rng(2)
    values = rng.normal(size=(50, columns)) * 10.0 ** rng.integers(-300, 300, (50, columns))
    for count in (1, 2, 50):
        texts = [
            orjson.dumps(part, option=orjson.OPT_SERIALIZE_NUMPY) for part in (np.arange(50)[:count], values[:count])
        ]
        lines = bytes(join_columns(*texts))
        assert lines == _lines(*texts)
        np.testing.assert_array_equal(np.loadtxt(io.BytesIO(lines), delimiter=",", ndmin=2)[:, 1:], values[:count])


def test_it_can_be_switched_off(monkeypatch):
    monkeypatch.setenv("GNOMON_KERNEL", "0")
    assert kernel.load_kernel() is None
    assert "NumPy" in kernel.describe_kernel()


@pytest.mark.parametrize("content", [b"", b"no library"])
def test_a_damaged_kernel_is_not_used(content, tmp_path):
    package = tmp_path / "kernel"
    shutil.copytree(Path(kernel.__file__).parent, package, ignore=shutil.ignore_patterns("kernel.*"))
    (package / "compiled").mkdir(exist_ok=True)
    (package / kernel.kernel_file_name()).write_bytes(content)
    run = "import kernel; print(kernel.load_kernel(), kernel.describe_kernel())"
    done = subprocess.run([sys.executable, "-c", run], cwd=tmp_path, capture_output=True, text=True, check=True)
    assert done.stdout == "None NumPy only, no compiled kernel\n"


@pytest.mark.parametrize("compiler", ["false", "no-such-compiler"])
def test_without_a_compiler_the_build_goes_on(compiler, tmp_path, monkeypatch):
    for file in ("hatch_build.py", "src/gnomon/kernel/kernel.c"):
        (tmp_path / file).parent.mkdir(parents=True, exist_ok=True)
        shutil.copy(ROOT / file, tmp_path / file)
    monkeypatch.setenv("CC", compiler)
    done = subprocess.run([sys.executable, "hatch_build.py"], cwd=tmp_path, capture_output=True, text=True, check=True)
    if sys.platform != "win32":
        assert done.stdout == "no C compiler that works\n"
        assert not (tmp_path / "src" / "gnomon" / "kernel" / kernel.kernel_file_name()).exists()
