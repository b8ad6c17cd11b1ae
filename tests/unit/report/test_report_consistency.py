"""A report never contradicts itself: numbers of one parameter are one number, with one sigma and one unit."""

from dataclasses import replace

import numpy as np
import pytest

import gnomon
from gnomon.assess.cameras.cameras_tables import CELLS
from gnomon.models.camera import Camera
from gnomon.readers.samples.table import guess_time_unit
from gnomon.recording import TriadSamples
from gnomon.report.cameras.lens import projection_spread
from gnomon.report.numbers import percent_text
from gnomon.report.page import write_report
from html_page import Page
from report_numbers import Shown, number, parameters_shown

AXES, TILTS = "xyz", ("yz", "zy", "zx")


def key(table: str, name: str, lenses: dict[str, Camera]) -> str | None:
    """Return the scalar that a row of a table of parameters shows; None of what is no scalar of the estimation."""
    group, _, row = name.partition(" | ")
    sensor = table.rpartition(" / ")[2].partition(" ")[0]
    last = row.rpartition(" ")[2]
    if table == "every parameter":
        return name
    if group.startswith("Lens") and sensor in lenses:
        return f"{sensor}.{lenses[sensor].parameter_names[lenses[sensor].parameter_symbols.index(row)]}"
    link = "T_cam_cam0" if "against" in table else "T_cam_imu"
    if group.startswith("Translation"):
        return f"{sensor}.{link}.translation[{AXES.index(last)}]"
    if group.startswith("Rotation from") and "against" in table and last in AXES:
        return f"{sensor}.{link}.rotation[{AXES.index(last)}]"
    if (group, row) == ("Time", "time shift"):
        return f"{sensor}.time_shift_cam_imu"
    triad = group[:1].lower()
    if group.startswith(("Accelerometer scale", "Gyroscope scale")):
        return f"imu0.S_{triad}[{AXES.index(last)}]"
    if group.startswith(("Accelerometer misalignment", "Gyroscope misalignment")):
        return f"imu0.M_{triad}[{TILTS.index(last)}]"
    if group.startswith("Gyroscope rotation"):
        return f"imu0.q_bg[{AXES.index(last)}]"
    if group.startswith("Gyroscope g-sensitivity"):
        return f"imu0.B_g[{3 * AXES.index(row[0]) + AXES.index(last)}]"
    return None


def twice_shown(page: str, lenses: dict[str, Camera]) -> dict[str, list[Shown]]:
    """Return scalar -> what the page shows of it, of those that stand there more than once."""
    found: dict[str, list[Shown]] = {}
    for table, name, one in parameters_shown(page):
        if scalar := key(table, name, lenses):
            found.setdefault(scalar, []).append(one)
    return {scalar: numbers for scalar, numbers in found.items() if len(numbers) > 1}


def page_of(result, folder) -> str:
    write_report(result, folder / "report.html")
    return (folder / "report.html").read_text(encoding="utf-8")


@pytest.fixture(scope="module")
def pair():
    made = gnomon.simulate_cameras(gnomon.CamerasScenario(views=12, cameras=2), 2)
    options = gnomon.CameraOptions(model=("pinhole-radtan",), board="stated", views=8)
    return gnomon.calibrate_cameras(made.recording, made.target, options)


@pytest.fixture(scope="module")
def waved():
    scenario = gnomon.CameraImuScenario(
        duration_s=8.0, camera_rate_hz=8.0, projection="eucm", distortion="none",
        intrinsics=(0.55, 1.1, 460, 458, 320, 240), distortion_coeffs=(),
    )  # fmt: skip
    made = gnomon.simulate_camera_imu(scenario, 3)
    options = gnomon.CameraImuOptions(free=("cam0.intrinsics",), model="full")
    return gnomon.calibrate_camera_imu(made.recording, made.target, options)


def lenses_of(result) -> dict[str, Camera]:
    return {name: camera.camera for name, camera in result.calibration.cameras.items()}


def test_cameras(pair, tmp_path):
    numbers = twice_shown(page_of(pair, tmp_path), lenses_of(pair))
    assert len(numbers) >= 22  # two lenses of eight numbers, and a pose
    for scalar, shown in numbers.items():
        assert all(one.agrees(shown[0]) for one in shown), (scalar, shown)


def test_cameras_with_an_imu(waved, tmp_path):
    page = page_of(waved, tmp_path)
    numbers = twice_shown(page, lenses_of(waved))
    assert len(numbers) >= 30
    for scalar, shown in numbers.items():
        assert all(one.agrees(shown[0]) for one in shown), (scalar, shown)
    assert [one.unit for one in numbers["cam0.intrinsics[0]"]] == ["", ""]
    every = {name: one for table, name, one in parameters_shown(page) if table == "every parameter"}
    gravity = waved.calibration.gravity
    assert every["gravity.magnitude"].sigma == pytest.approx(gravity.sigma)
    assert f"{gravity.value:g} ± {gravity.sigma:g}" in Page(page).text.replace("9.806650", "9.80665")


def test_the_test_sees_contradictions(waved, tmp_path):
    """Another sigma in one of two tables, and a missing unit."""
    first = waved.diagnostics.parameters
    at = next(i for i, p in enumerate(first) if p.name == "cam0.time_shift_cam_imu")
    changed = (*first[:at], replace(first[at], sigma=1.5 * first[at].sigma), *first[at + 1 :])
    page = page_of(replace(waved, diagnostics=replace(waved.diagnostics, parameters=changed)), tmp_path)
    shown = twice_shown(page, lenses_of(waved))["cam0.time_shift_cam_imu"]
    assert not shown[0].agrees(shown[1])
    assert not shown[0].agrees(replace(shown[0], unit="px"))
    assert number("−1.2·10⁻⁴") == pytest.approx((-1.2e-4, 0.05e-4))


def test_whole_coverage_leaves_no_cell_without_corners(pair):
    camera = pair.calibration.cameras["cam0"].camera
    width, height = camera.resolution
    rows, columns = CELLS
    one_a_cell = [
        ((j + 0.5) * width / columns - 0.5, (i + 0.5) * height / rows - 0.5)
        for i in range(rows)
        for j in range(columns)
    ]
    covariance = np.eye(len(camera.parameters)) * 1e-6
    assert projection_spread(camera, covariance, np.array(one_a_cell)).seen.all()
    missing = projection_spread(camera, covariance, np.array(one_a_cell[:-1])).seen
    assert 0 < np.count_nonzero(~missing) < 0.05 * missing.size
    assert (percent_text(1.0), percent_text(79 / 80), percent_text(0.9999)) == (
        "100\u00a0%",
        "99\u00a0%",
        "> 99\u00a0%",
    )


def test_a_reader_states_the_rate_that_everything_else_states():
    rng = np.random.default_rng(1)
    packets = np.repeat(np.arange(600) * 50_000_000, 5) + np.tile(np.arange(5) * 2_000_000, 600)
    for t_ns in (packets, np.arange(3000) * 10_000_000 + rng.integers(0, 100_000, 3000)):
        rate = TriadSamples(t_ns=t_ns, values=np.zeros((len(t_ns), 3)), unit="m/s^2").rate_hz
        assert f"{rate:.4g} Hz" in guess_time_unit(t_ns * 1e-9)[1]
