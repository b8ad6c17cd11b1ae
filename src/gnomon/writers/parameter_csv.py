"""A table of name, value, sigma and unit for spreadsheets; read back by `readers.own.parameter_csv`."""

from collections.abc import Iterator

from ..calibration import Calibration, element_names, parameters
from ..models.camera import Camera
from .calibration_file import FRAMES
from .camera_entries import IMU_EQUATION, camera_equation
from .context import Context
from .export import Export, Loss
from .units_text import element_units

_EQUATION = (
    "measured = sensitivity true + bias, of the gyroscope + g_sensitivity f; f specific force [m/s^2]; rows: sensor "
    "axes, columns: body axes; body frame {frame}: {words}"
)

_ROTATION = (
    "every ...rotation[0..2] is a rotation vector: axis times angle [rad], R = exp of its cross-product matrix; its "
    "sigmas are about the axes of the frame on the right of the name"
)


def export(calibration: Calibration, context: Context) -> Export:
    """Return `calibration.csv`: a row for every scalar of every IMU and camera, for gravity, body frame and lenses."""
    frame = calibration.frame
    rows = ["name,value,sigma,unit"]
    equation = _EQUATION.format(frame=frame, words=FRAMES.get(frame, FRAMES["user"]))
    rows += [f"comment,{_text(equation)},,"] if calibration.imus else []
    rows += [f"comment,{_text(camera_equation(calibration))},,"] if calibration.cameras else []
    posed = [path for path, _ in parameters(calibration.imus, calibration.cameras) if path.endswith(".rotation")]
    rows += [f"comment,{_text(_ROTATION)},,"] if posed else []
    placed = any(imu.T_imu_body is not None for imu in calibration.imus.values())
    rows += [f"comment,{_text(IMU_EQUATION)},,"] if placed else []
    rows += [f"comment,{_text(remark)},," for remark in context.remarks]
    rows.append(f"body_frame,{frame},,")
    if calibration.imus:
        rows.append(f"gravity,{float(calibration.gravity.value)!r},{float(calibration.gravity.sigma)!r},m/s^2")
    alone = not calibration.imus
    rows += [row for name, camera in calibration.cameras.items() for row in _camera(name, camera.camera, alone=alone)]
    for path, value in parameters(calibration.imus, calibration.cameras):
        numbers = value.ravel().tolist(), calibration.sigma(path).ravel().tolist(), element_units(calibration, path)
        for name, number, sigma, unit in zip(element_names(path, value.shape), *numbers, strict=True):
            rows.append(f'"{name}",{number!r},{sigma!r},{unit}')
    loss = Loss(
        what="correlations and origin",
        why="the table has sigmas, but no covariances, no verdict and no provenance. Keep calibration.yaml.",
    )
    return Export(files={"calibration.csv": "\n".join(rows) + "\n"}, losses=(loss,))


def _camera(name: str, camera: Camera, *, alone: bool) -> Iterator[str]:
    """Yield what is no number that was estimated."""
    yield f"{name}.model,{camera.model},,"
    yield f"{name}.resolution,{camera.resolution[0]} {camera.resolution[1]},,px"
    if alone and camera.line_delay_s:
        yield f"{name}.line_delay,{float(camera.line_delay_s)!r},0.0,s"
    if camera.topic:
        yield f"{name}.rostopic,{_text(camera.topic)},,"


def _text(text: str) -> str:
    quoted = text.replace('"', '""')
    return f'"{quoted}"'
