"""`gnomon camera-imu` on recordings with something wrong: it says what, in words, and is never confidently wrong."""

import json
import shutil
import sys
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest

sys.path.insert(0, str(Path(__file__).parents[1]))

import gnomon
from camera_imu_folder import (
    altogether,
    corners,
    emptied,
    renumbered,
    replaced,
    samples,
    scaled,
    some_frames,
    stated_extrinsics,
    without,
)
from gnomon import CameraImuScenario, simulate_camera_imu
from gnomon.cli.files import CAMERA_IMU_FILES
from gnomon.geometry.rotations import rotvec_from_rotation
from gnomon.writers.simulated_cameras import save_camera_imu_recording

SCENARIO = CameraImuScenario(duration_s=22.0, imu_rate_hz=100.0, camera_rate_hz=10.0)
"""Just long enough that nothing is wrong with it but what is done to it."""

MOST_SIGMAS = 5.0
PER_G, DEGREES = 1 / 9.80665, 180 / np.pi
LONG_AGO_NS = 3600 * 10**9
UNNAMED = "t_ns,ax,ay,az,gx,gy,gz"
CORNERS = 144
rng = np.random.default_rng(0)
OTHER_ORDER = rng.permutation(CORNERS)


@cache
def simulated(scenario, seed=1):
    return simulate_camera_imu(scenario, seed)


@pytest.fixture(scope="module")
def folder_of(tmp_path_factory):
    """Return a function that writes a simulated recording, once."""

    @cache
    def written(scenario, seed=1):
        folder = tmp_path_factory.mktemp("rig")
        save_camera_imu_recording(simulated(scenario, seed), folder)
        return folder

    return written


@pytest.fixture
def spoilt(folder_of, tmp_path):
    """Return a function that makes a folder of a case, alone in its parent."""

    def make(case):
        folder = tmp_path / "walk"
        shutil.copytree(folder_of(replace(SCENARIO, **case.scenario)), folder)
        if case.imu_of_seed is not None:
            shutil.copy(folder_of(SCENARIO, case.imu_of_seed) / "imu0.csv.gz", folder)
        case.edit(folder)
        return folder

    return make


@dataclass(frozen=True, kw_only=True)
class Case:
    """A recording with something wrong.

    Attributes
    ----------
    edit : what is done to the folder
    scenario : changes of the scenario
    imu_of_seed : the samples are those of another recording
    arguments : of the command
    words : to be found in the message, or in the finding's message
    finding : code of the finding that names the suspicious part
    verdict : of the result
    """

    edit: Any = lambda _: None
    scenario: Any = ()
    imu_of_seed: int | None = None
    arguments: tuple[str, ...] = ()
    words: str = ""
    finding: str = ""
    verdict: str = "fail"

    def __post_init__(self):
        object.__setattr__(self, "scenario", dict(self.scenario))


def nan_sample(t_ns, values):
    values[500, 2] = np.nan
    return t_ns, values


def nan_pixels(rows):
    def change(t_ns, point, pixels):
        pixels[rows] = np.nan
        return t_ns, point, pixels

    return corners(change)


def first_half(t_ns, values):
    kept = t_ns < t_ns[0] + 10 * 10**9
    return t_ns[kept], values[kept]


NEVER_AT_ONCE = altogether(
    samples(first_half), some_frames(lambda t: t[t > t[0] + 12 * 10**9]), without("cam0_frames.csv")
)
NO_ROWS = some_frames(lambda t: t[:0])

REFUSED = {
    "streams that do not overlap": Case(edit=NEVER_AT_ONCE, words="streams are not of one recording"),
    "static": Case(scenario={"motion": "static"}, words="at rest"),
    "translation without any turn": Case(scenario={"motion": "translation"}, words="Turn about all three axes"),
    "board in millimetres": Case(edit=replaced("target.yaml", "0.088", "88.0"), words="tagSize: found 88 m"),
    "deg/s stated as rad/s": Case(edit=scaled(gyroscope=DEGREES), words="in deg/s, not in rad/s"),
    "rad/s stated as deg/s": Case(arguments=("--units", "m/s^2 deg/s"), words="in rad/s, not in deg/s"),
    "deg/s said to be SI": Case(
        edit=scaled(gyroscope=DEGREES, header=UNNAMED), arguments=("--units", "si"), words="in deg/s, not in rad/s"
    ),
    "g stated as m/s^2": Case(edit=scaled(accelerometer=PER_G), words="reads 1.1"),
    "m/s^2 stated as g": Case(arguments=("--units", "g rad/s"), words="The unit is wrong"),
    "corner ids shifted by one": Case(edit=renumbered(lambda i: (i + 1) % CORNERS), words="the same rotation"),
    "corner ids in any order": Case(edit=renumbered(lambda i: OTHER_ORDER[i]), words="the same rotation"),
    "corner ids beyond the board": Case(edit=renumbered(lambda i: i + 100), words="corners 0 to 143"),
    "corner ids below zero": Case(edit=renumbered(lambda i: i - 1), words="corner -1 is not on the target"),
    "nine frames": Case(edit=some_frames(lambda t: t[::24][:9]), words="the board in 9 of them"),
    "nine frames in a row": Case(edit=some_frames(lambda t: t[:9]), words="the board in 9 of them"),
    "twelve frames far apart": Case(edit=some_frames(lambda t: t[::18][:12]), words="the board was seen in 12 frames"),
    "NaN in the IMU": Case(edit=samples(nan_sample), words="line 502, column 4"),
    "NaN in all corners": Case(edit=nan_pixels(slice(None)), words="29194 of 29194 rows"),
    "no corner at all": Case(edit=NO_ROWS, words="cam0_corners.csv.gz"),
    "a camera of two that sees no board": Case(
        scenario={"cameras": 2}, edit=corners(lambda t, i, p: (t[:0], i[:0], p[:0]), "cam1"), words="cam1"
    ),
    "a camera of two that hardly sees the board": Case(
        scenario={"cameras": 2}, edit=corners(lambda t, i, p: (t[:999], i[:999], p[:999]), "cam1"), words="cam1: "
    ),
    "image mirrored": Case(
        edit=corners(lambda t, i, p: (t, i, p * [-1, 1] + [639, 0])), words="whether the images are mirrored"
    ),
    "gyroscope's axis negated": Case(
        edit=samples(lambda t, x: (t, x * [1, 1, 1, 1, 1, -1])), words="the sign of gyroscope z is flipped"
    ),
    "no corners": Case(edit=without("cam0_corners.csv.gz"), words="no images of a camera in this folder"),
    "no samples": Case(edit=without("imu0.csv.gz"), words="no samples of an IMU"),
    "camchain missing": Case(edit=without("camchain.yaml"), words="--cam is missing"),
    "target missing": Case(edit=without("target.yaml"), words="--target is missing"),
    "imu.yaml named but missing": Case(arguments=("--imu", "imu.yml"), words="imu.yml"),
    **{
        f"{file} empty": Case(edit=emptied(file), words=file.removesuffix(".gz"))
        for file in (
            *("camchain.yaml", "imu.yaml", "target.yaml"),
            *("imu0.csv.gz", "cam0_corners.csv.gz", "cam0_frames.csv"),
        )
    },
}
"""Nothing is calibrated; `words` are in the message."""


def from_the_top(point):
    """Number the rows of tags from the top."""
    row, column = np.divmod(point, 12)
    return (10 - row // 2 * 2 + row % 2) * 12 + column


SWAPPED_LENS = altogether(
    replaced("camchain.yaml", "460.0, 458.5, 322.4, 237.1", "458.5, 460.0, 237.1, 322.4"),
    replaced("camchain.yaml", "640, 480", "480, 640"),
)

SUSPECT = {
    "IMU of another recording": Case(imu_of_seed=2, finding="rotation-disagrees", words="52 % of the rotation"),
    "a tag 10 % too large": Case(
        edit=replaced("target.yaml", "0.088", "0.0968"), finding="target-scale", words="9.5 % smaller than stated"
    ),
    "a tag 2 % too large": Case(
        edit=replaced("target.yaml", "0.088", "0.08976"),
        finding="target-scale",
        words="2 % smaller than",
        verdict="warn",
    ),
    "gaps between the tags too small": Case(
        edit=replaced("target.yaml", "tagSpacing: 0.3", "tagSpacing: 0.25"), finding="tag-spacing"
    ),
    "focal length 10 % too long": Case(
        scenario={"focal_error": 0.1}, finding="lens-found", words="focal length -9 %", verdict="warn"
    ),
    "no distortion": Case(
        edit=replaced("camchain.yaml", r"\[-0.28, 0.075, 0.0002, -0.00015\]", "[0.0, 0.0, 0.0, 0.0]"),
        finding="distortion",
        verdict="warn",
    ),
    "one axis": Case(
        scenario={"motion": "one-axis"}, finding="rotation-one-axis", words="about one axis only, its optical axis"
    ),
    "tags numbered from the top": Case(edit=renumbered(from_the_top), finding="tag-spacing"),
    "camera upside down in camchain.yaml": Case(
        edit=stated_extrinsics(np.diag([-1.0, -1.0, 1.0])),
        finding="extrinsics-contradicted",
        words="180 deg",
        verdict="warn",
    ),
    "IMU of another recording, another clock": Case(
        imu_of_seed=2, edit=samples(lambda t, x: (t + LONG_AGO_NS, x)), finding="rotation-disagrees"
    ),
    "a tag 2 % too small": Case(
        edit=replaced("target.yaml", "0.088", "0.08624"),
        finding="target-scale",
        words="2 % larger than",
        verdict="warn",
    ),
    "principal point 30 px off": Case(
        scenario={"principal_point_error_px": 30.0}, finding="lens-found", words="principal point 42 px", verdict="warn"
    ),
    "lens and resolution turned": Case(edit=SWAPPED_LENS, finding="lens-found", verdict="warn"),
    "one of two lenses wrong": Case(
        scenario={"cameras": 2},
        edit=replaced("camchain.yaml", r"(?s)(cam1:.*intrinsics: \[)460.0, 458.5", r"\g<1>506.0, 504.4"),
        finding="lens-found",
        words="lens of cam1 is not as stated: focal length -9.1 %",
        verdict="warn",
    ),
}
"""There is a result, and a warning or a problem that names the suspicious part."""

NAMED = "t_ns,ax [{}],ay [{}],az [{}],gx [{}],gy [{}],gz [{}]".format
HARMLESS = {
    "nothing": Case(),
    "clocks of unrelated origin": Case(edit=samples(lambda t, x: (t + LONG_AGO_NS, x))),
    "another resolution": Case(edit=replaced("camchain.yaml", "640, 480", "480, 640")),
    "g and deg/s, named": Case(
        edit=scaled(accelerometer=PER_G, gyroscope=DEGREES, header=NAMED(*["g"] * 3, *["deg/s"] * 3)),
        words="converted from deg/s",
    ),
    "g and deg/s, not named": Case(
        edit=scaled(accelerometer=PER_G, gyroscope=DEGREES, header=UNNAMED), words="converted from g to m/s^2"
    ),
    "NaN in some corners": Case(edit=nan_pixels(slice(500, 505)), words="NaN or infinity"),
    "two corners swapped": Case(edit=renumbered(lambda i: np.where(i == 5, 6, np.where(i == 6, 5, i)))),
    "no noise stated": Case(edit=without("imu.yaml"), words="the noise of a consumer IMU is assumed"),
    "corners of cam1 missing": Case(
        scenario={"cameras": 2}, edit=without("cam1_corners.csv.gz", "cam1_frames.csv"), words="cam1"
    ),
}
"""The result is right all the same; `words` are among the assumptions."""


@pytest.fixture
def calibrated(run, spoilt):
    """Return a function that runs the command on a case: exit code, document, standard error, folder."""

    def command(case):
        folder = spoilt(case)
        out = folder.parent / "out"
        code, text, err = run(
            "camera-imu", folder, "-o", out, "--no-report", "--json", "--gravity", 9.80665, *case.arguments
        )
        assert "Traceback" not in err
        assert "bug" not in err
        return code, json.loads(text), err, folder

    return command


@pytest.mark.parametrize("case", REFUSED.values(), ids=REFUSED)
def test_what_cannot_be_calibrated_is_named_and_leaves_nothing(case, calibrated, names):
    code, document, err, folder = calibrated(case)
    message = document["error"]["message"]
    assert code == (2 if "is missing" in message else 3), err
    assert case.words in message
    assert err.count(message) == 1
    assert 40 < len(message) < 500
    assert names(folder.parent) == ["walk"]


@pytest.mark.first(9)
@pytest.mark.long
@pytest.mark.parametrize("case", SUSPECT.values(), ids=SUSPECT)
def test_what_is_suspicious_is_named(case, calibrated, names):
    code, document, err, folder = calibrated(case)
    result = gnomon.load(folder.parent / "out/calibration.yaml")
    assert document["verdict"] == result.verdict == case.verdict, err
    assert code == (4 if case.verdict == "fail" else 0)
    named = [f for f in result.assessment.findings if f.code == case.finding and f.severity in ("warning", "problem")]
    assert any(case.words in finding.message for finding in named)
    assert all(finding.cure for finding in named)
    assert case.finding in {finding["code"] for finding in document["calibration"]["assessment"]["findings"]}
    assert names(folder.parent / "out") == sorted(set(CAMERA_IMU_FILES) - {"report.html"})
    assert names(folder.parent) == ["out", "walk"]
    if case.finding == "extrinsics-contradicted":  # what was stated was not used
        assert most_sigmas(result, folder) < MOST_SIGMAS


def test_the_screen_says_it_too(run, spoilt):
    folder = spoilt(SUSPECT["a tag 2 % too large"])
    code, out, err = run("camera-imu", folder, "-o", folder.parent / "out", "--no-report")
    said = " ".join(out.split())
    assert code == 0, err
    assert said.startswith("detected: ")
    assert "warn: usable, with reservations" in said
    assert "The accelerometer says that the board is 2 % smaller than stated" in said
    assert "-> Measure the board and correct target.yaml" in said


@pytest.mark.parametrize("case", HARMLESS.values(), ids=HARMLESS)
def test_what_is_harmless_spoils_nothing(case, calibrated):
    code, document, err, folder = calibrated(case)
    assert code == 0, err
    result = gnomon.load(folder.parent / "out/calibration.yaml")
    assert result.verdict == "pass"
    assert any(case.words in text for text in document["assumptions"])
    assert most_sigmas(result, folder, shift=case is not HARMLESS["clocks of unrelated origin"]) < MOST_SIGMAS


BARELY = {
    "principal point 3 px off": Case(
        scenario={"principal_point_error_px": 3.0}, arguments=("--model", "full"), finding="intrinsics-doubtful"
    ),
    "a tag 0.5 % too large": Case(edit=replaced("target.yaml", "0.088", "0.08844"), finding="target-scale"),
    "an ideal IMU assumed": Case(arguments=("--model", "basic"), finding="model-too-simple"),
    "no g-sensitivity assumed": Case(arguments=("--model", "scale-misalignment"), finding="model-too-simple"),
    "noise stated a hundred times too low": Case(
        edit=replaced("imu.yaml", "noise_density: 0.00", "noise_density: 0.0000"),
        arguments=("--noise", "nominal", "--covariance", "ordinary"),
        finding="noise-differs",
    ),
}
"""Errors of many sigmas that are small on the whole."""


TAKEN_UP = {
    "principal point 3 px off": Case(scenario={"principal_point_error_px": 3.0}),
    "focal length 0.5 % too long": Case(scenario={"focal_error": 0.005}),
    "focal length 2 % too long": Case(scenario={"focal_error": 0.02}),
}
"""Errors of the lens that the recording proves, and the model takes up."""


@pytest.mark.first(1)
@pytest.mark.long
@pytest.mark.parametrize("case", TAKEN_UP.values(), ids=TAKEN_UP)
def test_a_lens_that_is_off_is_taken_up_and_said(case, calibrated):
    _, document, _, folder = calibrated(case)
    result = gnomon.load(folder.parent / "out/calibration.yaml")
    assert document["verdict"] == "pass"
    assert "intrinsics" in result.assessment.trust.added
    assert "lens-found" in {finding.code for finding in result.assessment.findings}
    assert most_sigmas(result, folder) < MOST_SIGMAS


@pytest.mark.parametrize("case", BARELY.values(), ids=BARELY)
def test_never_confidently_wrong(case, calibrated):
    _, document, _, folder = calibrated(case)
    result = gnomon.load(folder.parent / "out/calibration.yaml")
    assert most_sigmas(result, folder) > MOST_SIGMAS
    assert document["verdict"] == "warn"
    assert case.finding in {finding.code for finding in result.assessment.findings if finding.severity == "warning"}


def hung(t_ns, values):
    """Let one reading stand for 3 s of all six axes."""
    first, last = np.searchsorted(t_ns, t_ns[0] + np.array([8, 11]) * 10**9)
    values[first:last] = values[first]
    return t_ns, values


def test_an_imu_that_hangs_for_seconds_leaves_a_gap_that_is_named(calibrated):
    """It ended in normal equations that are singular: nothing held the trajectory there."""
    code, document, err, folder = calibrated(Case(edit=samples(hung)))
    result = gnomon.load(folder.parent / "out/calibration.yaml")
    assert code == 0, err
    assert document["verdict"] == "warn"
    stuck = [f for f in result.assessment.findings if f.code == "samples-stuck"]
    assert all("times in a row from 8.00 s" in finding.message for finding in stuck)
    assert stuck
    assert most_sigmas(result, folder) < MOST_SIGMAS


def test_a_lens_that_is_held_against_the_corners_widens_what_it_moves(calibrated):
    case = Case(scenario={"focal_error": 0.005}, arguments=("--model", "full"), finding="intrinsics-doubtful")
    _, document, _, folder = calibrated(case)
    result = gnomon.load(folder.parent / "out/calibration.yaml")
    assert document["verdict"] == "warn"
    assert case.finding in {finding.code for finding in result.assessment.findings}
    assert most_sigmas(result, folder) < MOST_SIGMAS


def most_sigmas(result, folder, *, shift=True):
    """Return the largest error of the result, in sigmas."""
    truth = gnomon.load(folder / "truth.yaml")
    imu, true = result.imus["imu0"], truth.imus["imu0"]
    worst = []
    for triad, names in (("accelerometer", ["sensitivity"]), ("gyroscope", ["sensitivity", "g_sensitivity"])):
        for name in names:
            error = getattr(getattr(imu, triad), name) - getattr(getattr(true, triad), name)
            worst.append(sigmas(error, result.sigma(f"imu0.{triad}.{name}")))
    for name, camera in result.cameras.items():
        expected = truth.cameras[name]
        turn = rotvec_from_rotation(expected.T_cam_imu[:3, :3].T @ camera.T_cam_imu[:3, :3])
        moved = camera.T_cam_imu[:3, 3] - expected.T_cam_imu[:3, 3]
        worst += [sigmas(turn, result.sigma(f"{name}.T_cam_imu.rotation"))]
        worst += [sigmas(moved, result.sigma(f"{name}.T_cam_imu.translation"))]
        if shift:
            late = np.array([camera.time_shift_cam_imu - expected.time_shift_cam_imu])
            worst += [sigmas(late, np.array([result.sigma(f"{name}.time_shift_cam_imu")]))]
    return max(worst)


def sigmas(error, sigma):
    """Return the largest of errors in sigmas, of those that were estimated."""
    estimated = np.ravel(sigma) > 0
    if not estimated.any():
        return 0.0
    return float(np.max(np.abs(np.ravel(error)[estimated]) / np.ravel(sigma)[estimated]))
