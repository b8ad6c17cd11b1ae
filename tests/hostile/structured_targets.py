"""Targets: structured files, our own and those of other projects."""

import io
import json
import tempfile
from collections.abc import Callable, Mapping
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import yaml

import gnomon
from camera_imu_result import make_camera_imu_result
from cameras_example import cameras_calibration
from cameras_result import make_cameras_result
from gnomon.calibrate.steps.camera_reading import kept_corners
from gnomon.cli.files import read_priors
from gnomon.findings import Finding
from gnomon.formats.conversion import export_texts
from gnomon.formats.foreign import as_calibration
from gnomon.formats.foreign_files import load_any, load_foreign
from gnomon.formats.kalibr.camchain import read_camchain
from gnomon.formats.kalibr.imu import read_imu_input
from gnomon.formats.kalibr.target import read_target
from gnomon.formats.own.dataclass_file import options_text, read_options, read_use
from gnomon.formats.own.noise_file import load_noise, noise_text
from gnomon.formats.sensor_inputs import read_cameras, read_imu_noise, read_imus, read_rig
from gnomon.formats.shared.losses import StatedImu
from gnomon.models.target import Target as Board
from gnomon.readers.images.image_recording import read_sensor
from gnomon.recording import ImuSamples, Recording, Source, TriadSamples
from gnomon.recording.samples import ImuNoise
from gnomon.results.calibration import Calibration, Provenance
from gnomon.results.sensor_noise import COEFFICIENTS, AxisNoise, Coefficient, SensorNoise, TriadNoise
from gnomon.simulate.scenarios.camera_imu import CameraImuScenario
from gnomon.simulate.scenarios.cameras import CamerasScenario
from gnomon.writers.kalibr_files import camera_imu_texts, camera_texts

from .promise import Target

GOLDEN = Path(__file__).parents[1] / "golden"
NOISE = ImuNoise(
    accelerometer_noise_density=0.0039,
    accelerometer_random_walk=0.0012,
    gyroscope_noise_density=8.73e-5,
    gyroscope_random_walk=2e-5,
)
CAM = {
    "camera_model": "pinhole", "intrinsics": [460.1, 458.5, 322.4, 237.1], "distortion_model": "radtan",
    "distortion_coeffs": [-0.28, 0.075, 2e-4, -1.5e-4], "resolution": [640, 480], "rostopic": "/cam0/image_raw",
}  # fmt: skip
CAM1 = {**CAM, "camera_model": "ds", "intrinsics": [-0.2, 0.55, 290.25, 291.5, 319.0, 241.0]}
CAM1 |= {"distortion_model": "none", "distortion_coeffs": [], "T_cn_cnm1": np.eye(4).tolist()}
PLACED = {**CAM, "T_cam_imu": np.eye(4).tolist(), "timeshift_cam_imu": 0.01}
IMU = {
    "accelerometer_noise_density": 0.0039, "accelerometer_random_walk": 0.0012, "gyroscope_noise_density": 8.73e-5,
    "gyroscope_random_walk": 2e-5, "rostopic": "/imu0", "update_rate": 200.0,
}  # fmt: skip
APRIL = {"target_type": "aprilgrid", "tagCols": 2, "tagRows": 2, "tagSize": 0.088, "tagSpacing": 0.3}
CHECKERBOARD = {"target_type": "checkerboard", "targetCols": 6, "targetRows": 4}
CHECKERBOARD |= {"rowSpacingMeters": 0.1, "colSpacingMeters": 0.1}
CIRCLES = {"target_type": "circlegrid", "targetCols": 6, "targetRows": 7, "spacingMeters": 0.02, "asymmetricGrid": True}
CHARUCO = {"target_type": "charuco", "targetCols": 6, "targetRows": 5, "squareSize": 0.03, "markerSize": 0.022}
CHARUCO |= {"dictionary": "DICT_4X4_50"}
EUROC = {
    "sensor_type": "camera", "comment": "x", "T_BS": {"cols": 4, "rows": 4, "data": np.eye(4).ravel().tolist()},
    "rate_hz": 20, "resolution": [640, 480], "camera_model": "pinhole", "intrinsics": [460.1, 458.5, 322.4, 237.1],
    "distortion_model": "radial-tangential", "distortion_coefficients": [-0.28, 0.075, 2e-4, -1.5e-4],
}  # fmt: skip
EUROC_IMU = {"sensor_type": "imu", "T_BS": EUROC["T_BS"], "rate_hz": 200, **{k: v for k, v in IMU.items() if "_" in k}}
BOARD = Board.aprilgrid(tag_cols=6, tag_rows=6, tag_size_m=0.088, tag_spacing=0.3)
USE = {"name": "drone", "camera_rotation": "0.05 deg", "time_shift": "0.2 ms", "gyroscope_scale": "0.1 %"}


def as_yaml(*documents: Any) -> list[bytes]:
    return [yaml.safe_dump(document, sort_keys=False).encode() for document in documents]


@cache
def camera_imu() -> Calibration:
    return make_camera_imu_result().calibration


@cache
def converted(form: str) -> Mapping[str, str]:
    """Return the files of another project, by name."""
    stated = {"imu0": StatedImu(noise=NOISE, update_rate_hz=200.0, topic="/imu0")}
    calibration = gnomon.load(GOLDEN / "calibration-gnomon-1.yaml") if form in _OF_IMUS else camera_imu()
    scales = {"accelerometer_lsb_per_g": 4096.0, "gyroscope_lsb_per_deg_s": 83.267} if form in _OF_SI else {}
    return export_texts(calibration, form, imu=stated if form in _NOISY else None, **scales).files


_OF_SI = ("px4", "ardupilot")
_OF_IMUS = ("imu_tk", "imucal", "px4", "ardupilot")
_NOISY = ("kalibr", "openvins", "vins-fusion", "orb-slam3", "basalt", "okvis")


def foreign(name: str, form: str, file: str, structure: str, *, alone: bool = True) -> Target:
    """Return the target of one of a project's files; those beside it are read along unless it is read alone."""

    def beside(folder: Path) -> None:
        for other, text in converted(form).items():
            (folder / other).write_text(text, encoding="utf-8")

    def read(folder: Path) -> None:
        others = [] if alone else [folder / other for other in converted(form) if other != file]
        found = load_foreign(folder / file, *others)
        if found.imus:
            as_calibration(found)

    return Target(
        name=name, file=file, form=structure, beside=beside, read=read,
        seeds=lambda: [converted(form)[file].encode()], per_byte=300,
    )  # fmt: skip


def _all_of(*reads: Callable[[Path], Any]) -> Callable[[Path], Any]:
    """Return a function that reads a file in several ways; the first refusal counts once all had their turn."""

    def read(path: Path) -> None:
        refused: list[gnomon.GnomonError] = []
        for one in reads:
            try:
                one(path)
            except gnomon.GnomonError as error:
                refused.append(error)
        if refused:
            raise refused[0]

    return read


def simple(name: str, file: str, seeds: Callable[[], list[bytes]], *reads: Callable[[Path], Any], form: str) -> Target:
    """Return the target of a file that stands alone."""
    read = _all_of(*reads)
    return Target(name=name, file=file, form=form, seeds=seeds, read=lambda folder: read(folder / file), per_byte=300)


def _golden() -> list[bytes]:
    return [path.read_bytes() for path in sorted(GOLDEN.glob("calibration-*.yaml"))]


def _own_json() -> list[bytes]:
    alone = export_texts(cameras_calibration(), "json").files
    return [next(iter(files.values())).encode() for files in (converted("json"), alone)]


def _results() -> list[bytes]:
    result = make_camera_imu_result(duration_s=20.0)
    found = result.diagnostics
    triads = {
        name.split(".")[1]: TriadSamples(
            t_ns=found.trajectory.t_ns, values=fit.measured[: len(found.trajectory.t_ns)], unit=fit.unit
        )
        for name, fit in found.signals.items()
    }
    recording = Recording(imus={"imu0": ImuSamples(**triads, noise=NOISE, topic="/imu0")})
    return [camera_imu_texts(result, recording, BOARD)["results-imucam.txt"].encode()]


def _noise_yaml() -> list[bytes]:
    levels = (3e-3, 2e-4, 1e-5, 1e-6)
    axis = AxisNoise(
        **{name: Coefficient(value=v, sigma=v / 7) for name, v in zip(COEFFICIENTS[1:], levels, strict=True)},
        **{COEFFICIENTS[0]: Coefficient(value=0.0, bound=1e-5)}, fitted_from_s=0.04, misfit=0.0123,
    )  # fmt: skip
    triad = TriadNoise(rate_hz=200.0, samples=1_234_567, tau_s=(0.005, 1310.72), axes=(axis, axis, axis))
    noise = SensorNoise(
        accelerometer=triad, gyroscope=triad, t_init_s=41.0, verdict="warn",
        findings=(Finding(severity="warning", code="noise-drift", message="it drifts", cure="wait"),),
        provenance=Provenance(gnomon_version="9", method="noise", inputs=(Source(name="a.npz", sha256="0" * 64),)),
    )  # fmt: skip
    return [noise_text(noise).encode(), *as_yaml({"imu0": IMU})]


def _npz(arrays: Mapping[str, Any]) -> bytes:
    file = io.BytesIO()
    np.savez_compressed(file, **arrays)
    return file.getvalue()


def _cached() -> list[bytes]:
    told = json.dumps({"resolution": [640, 480], "dropped": [["blurred", 2]], "notes": ["a note"]})
    count = 6
    arrays = {
        "t_ns": 50_000_000 * np.arange(3), "frame": np.repeat(np.arange(3), 2), "point": np.tile([0, 1], 3),
        "pixels": np.full((count, 2), 100.5), "sigma_px": np.full(count, 0.1), "blur_px": np.ones(3),
        "black": np.zeros(3), "white": np.full(3, 255.0), "told": np.array(told),
    }  # fmt: skip
    return [_npz(arrays)]


@cache
def _known() -> Any:
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder, "camchain.yaml")
        path.write_bytes(as_yaml({"cam0": CAM})[0])
        return read_cameras(path)["cam0"]


@cache
def _camera_texts() -> tuple[str, str]:
    """Return the camchain.yaml and the results-cam.txt of one calibration."""
    lenses, results = camera_texts(make_cameras_result(), BOARD).values()
    return lenses, results


STRUCTURED: tuple[Target, ...] = (
    simple("calibration-yaml", "calibration.yaml", _golden, gnomon.load, load_any, read_cameras, read_rig, form="yaml"),
    simple("calibration-json", "calibration.json", _own_json, gnomon.load, read_rig, form="json"),
    simple("noise-yaml", "noise.yaml", _noise_yaml, load_noise, read_imu_noise, form="yaml"),
    simple(
        "prior-files", "prior.yaml", lambda: [*_golden(), *_noise_yaml()], lambda p: read_priors((str(p),)), form="yaml"
    ),
    simple("use-yaml", "use.yaml", lambda: as_yaml(USE), read_use, form="yaml"),
    simple(
        "camera-imu-scenario", "scenario.yaml", lambda: [options_text(CameraImuScenario()).encode()],
        lambda path: read_options(path, CameraImuScenario), form="yaml",
    ),
    simple(
        "cameras-scenario", "scenario.yaml", lambda: [options_text(CamerasScenario()).encode()],
        lambda path: read_options(path, CamerasScenario), form="yaml",
    ),
    simple(
        "camchain", "camchain.yaml", lambda: as_yaml({"cam0": CAM, "cam1": CAM1}, {"cam0": PLACED}, CAM),
        read_cameras, read_camchain, load_foreign, form="yaml",
    ),
    simple("imu-yaml", "imu.yaml", lambda: as_yaml({"imu0": IMU}, IMU), read_imus, read_imu_input, load_foreign,
           read_imu_noise, form="yaml"),
    simple(
        "target-yaml", "target.yaml", lambda: as_yaml(APRIL, CHECKERBOARD, CIRCLES, CHARUCO), read_target, load_foreign,
        form="yaml",
    ),
    simple(
        "sensor-yaml", "sensor.yaml", lambda: as_yaml(EUROC, EUROC_IMU),
        lambda path: read_sensor(path, "cam0/sensor.yaml", []), read_cameras, read_imus, form="yaml",
    ),
    Target(
        name="corner-cache", file="corners.npz", seeds=_cached, beside=lambda _: _known(),
        read=lambda folder: kept_corners(folder / "corners.npz", _known()),
    ),
    simple("parameter-csv", "parameters.csv", lambda: [next(iter(converted("csv").values())).encode()], load_foreign,
           load_any, form="text"),
    simple("kalibr-results-imucam", "results-imucam.txt", _results, load_foreign, form="text"),
    Target(
        name="kalibr-results-cam", file="results-cam.txt", form="text", seeds=lambda: [_camera_texts()[1].encode()],
        beside=lambda folder: (folder / "camchain.yaml").write_text(_camera_texts()[0]),
        read=lambda folder: _all_of(load_foreign, read_cameras)(folder / "results-cam.txt"),
    ),
    foreign("kalibr-camchain-imucam", "kalibr", "camchain-imucam.yaml", "yaml", alone=False),
    foreign("kalibr-imu-result", "kalibr", "imu.yaml", "yaml", alone=False),
    foreign("openvins-imu-chain", "openvins", "kalibr_imu_chain.yaml", "yaml"),
    foreign("openvins-imucam-chain", "openvins", "kalibr_imucam_chain.yaml", "yaml", alone=False),
    foreign("basalt", "basalt", "calibration.json", "json"),
    foreign("okvis", "okvis", "okvis.yaml", "yaml"),
    foreign("orb-slam3", "orb-slam3", "orb_slam3.yaml", "yaml"),
    foreign("vins-fusion", "vins-fusion", "config.yaml", "yaml"),
    foreign("vins-lens", "vins-fusion", "cam0.yaml", "yaml"),
    foreign("ros2-launch", "ros2", "static_transforms.launch.yaml", "yaml"),
    foreign("ros2-camera-info", "ros2", "cam0_camera_info.yaml", "yaml"),
    foreign("imucal", "imucal", "imu0.json", "json"),
    foreign("imu-tk", "imu_tk", "imu0_acc.calib", "text"),
    foreign("px4", "px4", "px4.params", "text"),
    foreign("ardupilot", "ardupilot", "ardupilot.param", "text"),
)  # fmt: skip
