"""Calibrations side by side: what is the same stays the same in every frame, form and format; what differs is named."""

from dataclasses import replace

import numpy as np
import pytest

import gnomon
from gnomon.assess.comparison.candidates import ComparisonCandidate, in_common_frame
from gnomon.assess.comparison.comparison import lens_difference
from gnomon.assess.comparison.quantities import statement_of
from gnomon.calibrate.comparison import compare
from gnomon.errors import FormatError, OptionError
from gnomon.geometry.rotations import rotation_from_rotvec
from gnomon.models.camera import Camera
from gnomon.recording import Source
from gnomon.results.calibration import Calibration, Covariance, Gravity
from gnomon.results.sensors import calibration_parameters

SI = ("m/s^2", "rad/s")


def shifted(
    calibration: Calibration, *, translation=(0.0, 0.0, 0.0), rotation=(0.0, 0.0, 0.0), shift=0.0, inverse=False
):
    """Return the calibration with another pose and time shift of cam0, about the body's axes and in metres."""
    camera = calibration.cameras["cam0"]
    T = camera.T_cam_imu.copy()
    T[:3, :3] = T[:3, :3] @ rotation_from_rotvec(np.array(rotation))
    T[:3, 3] += translation
    T = np.linalg.inv(T) if inverse else T
    moved = replace(camera, T_cam_body=T, time_shift_cam_imu=camera.time_shift_cam_imu + shift)
    return replace(calibration, cameras={**calibration.cameras, "cam0": moved})


def from_another_recording(calibration: Calibration, name: str) -> Calibration:
    inputs = (Source(name=name, sha256=name.encode().hex()),)
    return replace(calibration, provenance=replace(calibration.provenance, inputs=inputs))


@pytest.mark.parametrize("frame", ["accel-x", "accel-z", "user"])
@pytest.mark.parametrize("other", ["accel-x", "accel-z"])
def test_the_same_calibration_in_two_frames(camera_calibration, frame, other):
    first = camera_calibration(3, frame=frame)
    second = first.in_frame(other)
    found = compare(first, second)
    for item in found.differences:
        size = np.abs(found.block(item.path).values).max() if item.path in {b.path for b in found.blocks} else 1.0
        np.testing.assert_allclose(item.values, 0.0, atol=1e-11 * max(size, 1.0), err_msg=item.path)
    for block in found.blocks:
        np.testing.assert_allclose(block.sigmas[0], block.sigmas[1], rtol=1e-6, err_msg=block.path)
    assert found.verdict == "pass"
    paths = [block.path for block in found.blocks]
    assert paths[:3] == ["imu0.accelerometer.scale", "imu0.accelerometer.misalignment", "imu0.accelerometer.bias"]
    assert {"imu0.gyroscope.rotation", "imu0.gyroscope.g_sensitivity", "cam1.rotation", "cam1.time_shift"} < {*paths}


LOST = {
    "kalibr": ("bias",),
    "openvins": ("bias",),
    "basalt": ("g_sensitivity", "time_shift"),
    "imu_tk": ("g_sensitivity", "cam0", "cam1"),
    "imucal": ("cam0", "cam1"),
    "csv": (),
    "json": (),
    "vins-fusion": ("imu0", "time_shift"),
    "orb-slam3": ("imu0", "time_shift"),
    "okvis": ("imu0", "time_shift"),
    "ros2": ("imu0", "time_shift"),
}
"""What a format does not hold: many have one time shift for all cameras, or no model of the IMU."""


@pytest.mark.parametrize("form", LOST)
def test_written_in_another_format_and_compared(camera_calibration, tmp_path, form):
    """Frames, forms, signs, the direction of T and the row of a shift: only what the format cannot hold differs."""
    calibration = camera_calibration(5, cameras=2)
    lenses = [
        Camera(projection="pinhole", intrinsics=[460, 459, 320, 240], distortion="radtan",
               distortion_coeffs=[-0.28, 0.07, 2e-4, 1e-4], resolution=(640, 480), line_delay_s=3e-5),
        Camera(projection="pinhole", intrinsics=[300, 301, 330, 250], distortion="equidistant",
               distortion_coeffs=[0.01, -0.02, 0.005, -0.001], resolution=(640, 480)),
    ]  # fmt: skip
    lenses = lenses[:1] * 2 if form == "orb-slam3" else lenses  # which takes one kind only
    cameras = {
        name: replace(camera, camera=lens)
        for (name, camera), lens in zip(calibration.cameras.items(), lenses, strict=True)
    }
    names = gnomon.results.calibration.covariance_names(calibration.imus, cameras)
    calibration = replace(
        calibration, cameras=cameras, uncertainty=Covariance(names=names, matrix=1e-8 * np.eye(len(names)))
    )
    gnomon.convert(calibration, form, tmp_path / form)
    found = compare(calibration, tmp_path / form, names=["original", form])
    compared_paths = {item.path for item in found.differences}
    everything = set(statement_of(in_common_frame(ComparisonCandidate.of("a", calibration))).quantities)
    expected = {path for path in everything if not any(word in path for word in LOST[form])}
    expected -= {path for path in everything if path.endswith(".line_delay")}
    assert expected - {path for path in expected if path.endswith("lens")} <= compared_paths
    for item in found.differences:
        if any(word in item.path for word in LOST[form]) or item.path.endswith("line_delay"):
            continue
        values = found.block(item.path).values
        size = max(float(np.abs(values).max()), 1e-3)
        np.testing.assert_allclose(item.values, 0.0, atol=1e-9 * size, err_msg=item.path)
    assert all(lens.largest_px < 1e-6 for lens in found.lenses)
    assert "sigmas-not-stated" in {one.code for one in found.findings} or form in {"csv", "json"}


def test_derivatives(random_calibration):
    """The covariance of what is compared, against finite differences of the whole way."""
    calibration = random_calibration(2, frame="accel-z", units=("g", "deg/s"))
    rng = np.random.default_rng(0)

    def values(matrices):
        imu = calibration.imus["imu0"]
        accelerometer = replace(imu.accelerometer, sensitivity=matrices[0], bias=matrices[1])
        gyroscope = replace(imu.gyroscope, sensitivity=matrices[2], bias=matrices[3], g_sensitivity=matrices[4])
        imus = {"imu0": replace(imu, accelerometer=accelerometer, gyroscope=gyroscope)}
        return statement_of(in_common_frame(ComparisonCandidate.of("a", replace(calibration, imus=imus))))

    start = [value for _, value in calibration_parameters(calibration.imus)]
    free = [(value != 0).astype(float) for value in start]
    steps = [rng.normal(size=value.shape) * mask * np.abs(value).max() for value, mask in zip(start, free, strict=True)]
    direction = np.concatenate([step.ravel() for step in steps])
    matrix = np.outer(direction, direction)  # of one random scalar along the direction
    stated = statement_of(
        in_common_frame(
            ComparisonCandidate.of(
                "a", replace(calibration, uncertainty=replace(calibration.uncertainty, matrix=matrix))
            )
        )
    )
    h = 1e-6
    ahead, behind = (values([v + sign * h * s for v, s in zip(start, steps, strict=True)]) for sign in (1, -1))
    for path, quantity in stated.quantities.items():
        sigma = np.sqrt(np.diag(stated.covariance)[quantity.rows])
        one, other = ahead.quantities[path], behind.quantities[path]
        if quantity.rotation is None:
            slope = (one.values - other.values) / (2 * h)
        else:
            slope = gnomon.geometry.rotations.rotvec_from_rotation(other.rotation.T @ one.rotation) / (2 * h)
        np.testing.assert_allclose(np.abs(slope), sigma, rtol=1e-5, atol=1e-7 * np.abs(slope).max(), err_msg=path)


def test_difference_of_rotations_is_about_the_body(camera_calibration):
    first = camera_calibration(1)
    found = compare(shifted(first, rotation=(0.0, 0.02, 0.0)), first, names="ab")
    np.testing.assert_allclose(found.difference("a", "b", "cam0.rotation").values, [0, 0.02, 0], atol=1e-12)
    np.testing.assert_allclose(found.difference("a", "b", "cam1.rotation").values, 0, atol=1e-12)


def test_the_odd_one_out_is_named(camera_calibration):
    first = camera_calibration(1)
    sigma = float(first.sigma("cam0.T_cam_imu.translation")[0])
    moved = shifted(first, translation=(31 * sigma, 0.0, 0.0))
    calibrations = [from_another_recording(one, name) for one, name in ((moved, "a"), (first, "b"), (first, "c"))]
    found = compare(*calibrations, names=["monday", "tuesday", "friday"])
    assert found.outside == ("monday",)
    assert found.verdict == "fail"
    assert found.headline.startswith("tuesday and friday agree; monday differs in the translation of cam0 by ")
    size = f"{31 * sigma * 1e3:.2g} mm ({31 / np.sqrt(1.5):.1f} sigma)"
    assert size in found.headline
    finding = next(one for one in found.findings if one.code == "stands-out")
    assert finding.severity == "problem"


def test_two_alone_do_not_tell_which_is_right(camera_calibration):
    first = camera_calibration(1)
    sigma = float(first.sigma("cam0.time_shift_cam_imu"))
    found = compare(shifted(first, shift=10 * sigma), first, names="ab")
    assert found.outside == ()
    assert found.verdict == "fail"
    assert f"time shift of cam0 by {1e4 * sigma:.2g} ms (7.1 sigma)" in found.headline


def test_biases_are_apart(random_calibration):
    first = random_calibration(1, units=SI)
    imu = first.imus["imu0"]
    changed = replace(imu, gyroscope=replace(imu.gyroscope, bias=imu.gyroscope.bias + 100.0))
    found = compare(first, replace(first, imus={"imu0": changed}), names="ab")
    assert found.verdict == "pass"
    assert not found.block("imu0.gyroscope.bias").judged
    assert any(one.code == "bias-instability" and "5.7e+03 deg/s" in one.message for one in found.findings)
    assert sum(one.code == "bias-instability" for one in found.findings) == 1  # the accelerometer's did not move


def test_what_one_holds_ideal_is_said(random_calibration, tmp_path):
    first = random_calibration(1, units=SI)
    (tmp_path / "imu.yaml").write_text("imu0:\n  model: calibrated\n  T_i_b: [[1.0,0.0,0.0,0.0],[0.0,1.0,0.0,0.0],"
                                       "[0.0,0.0,1.0,0.0],[0.0,0.0,0.0,1.0]]\n")  # fmt: skip
    nearly = replace(first, imus={"imu0": near_ideal(first.imus["imu0"])})
    found = compare(nearly, tmp_path / "imu.yaml", names=["ours", "kalibr"])
    finding = next(one for one in found.findings if one.code == "held-elsewhere-found")
    assert "kalibr holds at ideal or given values" in finding.message
    assert found.block("imu0.gyroscope.scale").assumed == ("kalibr",)
    assert found.block("imu0.gyroscope.scale").names == ("ours",)
    assert found.verdict == "warn"


def near_ideal(imu):
    accelerometer = replace(imu.accelerometer, sensitivity=np.tril(np.eye(3) + 0.3))
    return replace(imu, accelerometer=accelerometer, gyroscope=replace(imu.gyroscope, sensitivity=np.eye(3) * 1.1))


def test_an_inverted_pose_and_a_shift_of_the_other_sign(camera_calibration):
    first = shifted(camera_calibration(1), translation=(0.3, 0.1, 0.0), shift=0.02)
    other = replace(first.cameras["cam0"], time_shift_cam_imu=-first.cameras["cam0"].time_shift_cam_imu)
    mirrored = replace(shifted(first, inverse=True), cameras={**first.cameras, "cam0": other})
    codes = {one.code for one in compare(first, mirrored, names="ab").findings}
    assert "shift-sign" in codes
    codes = {one.code for one in compare(first, shifted(first, inverse=True), names="ab").findings}
    assert "pose-inverted" in codes
    codes = {one.code for one in compare(first, shifted(first, rotation=(0.1, 0.2, 0.0)), names="ab").findings}
    assert not {"pose-inverted", "shift-sign"} & codes


def test_the_same_recording_is_said(camera_calibration):
    first = from_another_recording(camera_calibration(1), "walk")
    said = {one.code for one in compare(first, first, names="ab").findings}
    assert "same-recording" in said
    other = from_another_recording(first, "run")
    assert "same-recording" not in {one.code for one in compare(first, other, names="ab").findings}


def test_the_error_of_a_shared_gravity_cancels(random_calibration):
    """Both assumed the same gravity, whose sigma dominates that of the scales: their difference must not profit."""
    calibration = random_calibration(1, units=SI)
    gravity = Gravity(value=9.80665, sigma=0.03, source="standard")
    S = calibration.imus["imu0"].accelerometer.sensitivity
    pull = np.zeros(33)
    pull[:9] = -S.ravel() / gravity.value
    pull[24:] = -calibration.imus["imu0"].gyroscope.g_sensitivity.ravel() / gravity.value
    own = 1e-10 * np.abs(S).max() ** 2 * np.diag((pull != 0).astype(float))
    matrix = own + gravity.sigma**2 * np.outer(pull, pull)
    uncertainty = replace(calibration.uncertainty, matrix=matrix)
    first = replace(calibration, gravity=gravity, uncertainty=uncertainty)
    second = replace(first, gravity=replace(gravity, source="latitude"))
    alone = np.sqrt(2 * np.diag(own)[:9].max()) / np.sqrt(2)
    same, different = (
        compare(first, other, names="ab").difference("a", "b", "imu0.accelerometer.scale") for other in (first, second)
    )
    np.testing.assert_allclose(same.sigmas, np.sqrt(2) * alone, rtol=1e-3)
    np.testing.assert_allclose(different.sigmas, np.sqrt(2) * np.diag(S) * 0.03 / 9.80665, rtol=1e-3)


def test_sensors_are_renamed(camera_calibration):
    one, two = camera_calibration(1, cameras=1), camera_calibration(1, cameras=2)
    found = compare(one, two, names="ab")
    assert any(item.code == "only-in-some" and "cam1 is in b only" in item.message for item in found.findings)
    renamed = replace(one, cameras={"left": one.cameras["cam0"]}, uncertainty=replace(
        one.uncertainty, names=tuple(name.replace("cam0", "left") for name in one.uncertainty.names)))  # fmt: skip
    found = compare(renamed, two, names="ab", rename={"a": {"left": "cam0"}})
    np.testing.assert_allclose(found.difference("a", "b", "cam0.rotation").values, 0.0, atol=1e-12)
    with pytest.raises(OptionError, match="a has no right"):
        compare(renamed, two, names="ab", rename={"a": {"right": "cam0"}})
    with pytest.raises(OptionError, match='"c" is none of the calibrations'):
        compare(renamed, two, names="ab", rename={"c": {"left": "cam0"}})


def test_units(random_calibration, tmp_path):
    first = random_calibration(1, units=SI)
    in_degrees = replace(first, imus={"imu0": scaled_gyroscope(first.imus["imu0"], 180 / np.pi, "deg/s")})
    found = compare(first, in_degrees, names="ab")
    np.testing.assert_allclose(found.difference("a", "b", "imu0.gyroscope.scale").values, 0, atol=1e-9)
    mislabelled = replace(first, imus={"imu0": scaled_gyroscope(first.imus["imu0"], 180 / np.pi, "rad/s")})
    with pytest.raises(FormatError, match=r"scale of b is 57\.3 times that of a.*ratio of deg/s and rad/s"):
        compare(first, mislabelled, names="ab")
    counts = replace(first, imus={"imu0": scaled_gyroscope(first.imus["imu0"], 131.0, "count")})
    found = compare(first, counts, names="ab")
    paths = {block.path for block in found.blocks if len(block.names) > 1}
    assert "imu0.gyroscope.misalignment" in paths
    assert "imu0.gyroscope.scale" not in paths
    assert any(one.code == "restated" and "scale, bias and g-sensitivity" in one.message for one in found.findings)


def scaled_gyroscope(imu, factor, unit):
    gyroscope = imu.gyroscope
    names = ("sensitivity", "bias", "g_sensitivity")
    values = {name: factor * getattr(gyroscope, name) for name in names}
    return replace(imu, gyroscope=replace(gyroscope, **values, unit=unit))


def test_nothing_in_common(random_calibration, tmp_path):
    first = random_calibration(1, units=SI, gyroscope=False)
    gyroscope = random_calibration(1, units=SI)
    imu = replace(gyroscope.imus["imu0"], accelerometer=None)
    names = gnomon.results.calibration.covariance_names({"imu0": imu})
    alone = replace(
        gyroscope, imus={"imu0": imu}, frame="gyro-x", uncertainty=Covariance(names=names, matrix=np.eye(len(names)))
    )
    with pytest.raises(OptionError, match="nothing in common"):
        compare(first, alone)
    with pytest.raises(OptionError, match="at least two"):
        compare(first)
    with pytest.raises(OptionError, match='two calibrations are called "a"'):
        compare(first, first, names=["a", "a"])


LENS = Camera(projection="pinhole", intrinsics=[460.0, 459.0, 320.0, 240.0], distortion="radtan",
              distortion_coeffs=[-0.28, 0.07, 2e-4, 1e-4], resolution=(640, 480))  # fmt: skip


def test_a_moved_principal_point_is_a_turn_of_the_camera():
    moved = LENS.with_parameters(LENS.parameters + 3.0 * np.eye(8)[2])
    found = lens_difference("cam0", ("a", LENS), ("b", moved))
    assert found.rms_px == pytest.approx(3.0, rel=0.01)
    assert found.turned_rms_px < 0.3
    np.testing.assert_allclose(found.turn, [0, -3.0 / 460, 0], atol=4e-4)
    same = lens_difference("cam0", ("a", LENS), ("b", LENS))
    assert same.same
    assert same.turned_rms_px < 1e-9


def test_another_model_of_one_lens():
    """The double sphere model of a lens that is a pinhole in truth (xi = alpha = 0)."""
    pinhole = Camera(projection="pinhole", intrinsics=[460.0, 459.0, 320.0, 240.0], distortion="none",
                     distortion_coeffs=[], resolution=(640, 480))  # fmt: skip
    sphere = Camera(projection="ds", intrinsics=[0.0, 0.0, 460.0, 459.0, 320.0, 240.0], distortion="none",
                    distortion_coeffs=[], resolution=(640, 480))  # fmt: skip
    found = lens_difference("cam0", ("a", pinhole), ("b", sphere))
    assert found.largest_px < 1e-9
    assert found.models == ("pinhole-none", "ds-none")
