"""How to use a calibration of cameras: equations, Kalibr's file, OpenCV, straightened images, and the next command."""

import numpy as np

from ..calibration import Calibration
from ..models.camera import Camera
from ..recording import Floats
from .page import Code, Section

PROJECTION_FORMULAS = {
    "pinhole": "m = (x, y) / z",
    "omni": "m = (x, y) / (ξ ρ + z),  ρ = |p|",
    "eucm": "m = (x, y) / (α d + (1 − α) z),  d = √(β (x² + y²) + z²)",
    "ds": "m = (x, y) / (α d₂ + (1 − α) z₂),  z₂ = ξ ρ + z,  d₂ = √(x² + y² + z₂²),  ρ = |p|",
}
DISTORTION_FORMULAS = {
    "none": "d = m",
    "radtan": "s = |m|²,  d = (1 + k1 s + k2 s²) m + (2 p1 mx my + p2 (s + 2 mx²), 2 p2 mx my + p1 (s + 2 my²))",
    "radtan5": "s = |m|²,  d = (1 + k1 s + k2 s² + k3 s³) m + (2 p1 mx my + p2 (s + 2 mx²), 2 p2 mx my + "
    "p1 (s + 2 my²))",
    "equidistant": "θ = atan |m|,  d = θ (1 + k1 θ² + k2 θ⁴ + k3 θ⁶ + k4 θ⁸) m / |m|",
    "fov": "d = atan(2 |m| tan(w/2)) m / (w |m|)",
}
_FILES = """\
calibration.yaml      everything, with covariance, findings and origin
camchain.yaml         lenses and baselines, as Kalibr writes them
results-cam.txt       summary, as Kalibr writes it
diagnostics.npz       the numbers behind the figures of this report"""


def use_section(calibration: Calibration) -> Section:
    """Return files, formulas and code for each lens, and what to do next."""
    blocks = [Code("Files beside this report", _FILES), Code("Next: the same cameras with an IMU", NEXT)]
    for name, entry in calibration.cameras.items():
        of = f" of {name}" if len(calibration.cameras) > 1 else ""
        blocks.append(Code(f"The lens{of}: from p = (x, y, z) in its frame to pixels", _formula(entry.camera)))
        if opencv := _opencv(entry.camera):
            blocks.append(Code(f"In OpenCV{of}", opencv))
    blocks.append(Code("In Python: straighten an image, whatever the lens", _python(calibration)))
    for name, entry in calibration.cameras.items():
        blocks.append(Code(f"{name} in Kalibr's camchain.yaml", _camchain(calibration, name, entry.camera)))
    return Section(
        "use",
        "How to use it",
        "A camera's x points to the right of its image, y down, z out of the lens; lengths are in metres, pixels "
        "are counted from the middle of the upper left one.",
        blocks,
    )


NEXT = """\
gnomon camera-imu RECORDING --cam calibration.yaml --imu imu.yaml --target target.yaml
gnomon show calibration.yaml
gnomon compare calibration.yaml ANOTHER/calibration.yaml"""


def _formula(camera: Camera) -> str:
    names, values = camera.parameter_symbols, camera.parameters.tolist()
    numbers = [f"{name} = {value:.10g}" for name, value in zip(names, values, strict=True)]
    split = len(camera.intrinsics)
    rows = [
        PROJECTION_FORMULAS[camera.projection],
        DISTORTION_FORMULAS[camera.distortion],
        "u = fu dx + pu,  v = fv dy + pv",
        "",
    ]
    rows += [", ".join(numbers[:split])] + ([", ".join(numbers[split:])] if numbers[split:] else [])
    return "\n".join(rows)


def _opencv(camera: Camera) -> str:
    """Return the lens as OpenCV has it; "" where it has none like it."""
    if camera.projection != "pinhole" or camera.distortion == "fov":
        return ""
    fu, fv, pu, pv = (f"{value:.10g}" for value in camera.intrinsics.tolist())
    coeffs = ", ".join(f"{value:.10g}" for value in camera.distortion_coeffs.tolist())
    fisheye = camera.distortion == "equidistant"
    call = "cv2.fisheye.undistortImage(image, K, d, Knew=K)" if fisheye else "cv2.undistort(image, K, d)"
    return (
        "import cv2\nimport numpy as np\n\n"
        f"K = np.array([[{fu}, 0, {pu}], [0, {fv}, {pv}], [0, 0, 1]])\n"
        f"d = np.array([{coeffs}])\n"
        f"straight = {call}"
    )


def _python(calibration: Calibration) -> str:
    name = next(iter(calibration.cameras))
    return (
        "import cv2\nimport gnomon\nimport numpy as np\n\n"
        'calibration = gnomon.load("calibration.yaml")\n'
        f"lens = calibration.cameras[{name!r}].camera\n"
        f'sigma = calibration.sigma("{name}.intrinsics")\n'
        "width, height = lens.resolution\n"
        "v, u = np.mgrid[:height, :width].astype(float)\n"
        "pu, pv = lens.intrinsics[-2:]\n"
        "focal = lens.project(np.array([[0.0, 0.0, 1.0]])).by_point[0]  # px per radian at the axis\n"
        "rays = np.stack([(u - pu) / focal[0, 0], (v - pv) / focal[1, 1], np.ones_like(u)], axis=-1).reshape(-1, 3)\n"
        "at = lens.project(rays).pixels.reshape(height, width, 2).astype(np.float32)\n"
        "straight = cv2.remap(image, at[..., 0], at[..., 1], cv2.INTER_LINEAR)"
    )


def _camchain(calibration: Calibration, name: str, camera: Camera) -> str:
    def row(values: Floats) -> str:
        return f"[{', '.join(f'{value:.12g}' for value in values.tolist())}]"

    lines = [
        f"{name}:",
        f"  camera_model: {camera.projection}",
        f"  intrinsics: {row(camera.intrinsics)}",
        f"  distortion_model: {camera.distortion}",
        f"  distortion_coeffs: {row(camera.distortion_coeffs)}",
        f"  resolution: [{camera.resolution[0]}, {camera.resolution[1]}]",
        f"  rostopic: {camera.topic or '/' + name + '/image_raw'}",
    ]
    before = list(calibration.cameras)[: list(calibration.cameras).index(name)]
    if before:
        T_before = calibration.cameras[before[-1]].T_cam_body
        T = calibration.cameras[name].T_cam_body @ np.linalg.inv(T_before)
        lines += ["  T_cn_cnm1:", *(f"  - {row(values)}" for values in T)]
    return "\n".join(lines)
