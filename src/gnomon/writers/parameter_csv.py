"""A table of name, value, sigma and unit for spreadsheets; read back by `readers.parameter_csv`."""

from ..calibration import Calibration, element_names, parameters
from .export import Export, Loss
from .units_text import element_units


def export(calibration: Calibration) -> Export:
    """Return `calibration.csv`: a row for every scalar of every IMU and camera, for gravity, body frame and lenses."""
    rows = ["name,value,sigma,unit", f"body_frame,{calibration.frame},,"]
    rows.append(f"gravity,{float(calibration.gravity.value)!r},{float(calibration.gravity.sigma)!r},m/s^2")
    rows += [f"{name}.model,{camera.camera.model},," for name, camera in calibration.cameras.items()]
    for path, value in parameters(calibration.imus, calibration.cameras):
        numbers = value.ravel().tolist(), calibration.sigma(path).ravel().tolist(), element_units(calibration, path)
        for name, number, sigma, unit in zip(element_names(path, value.shape), *numbers, strict=True):
            rows.append(f'"{name}",{number!r},{sigma!r},{unit}')
    loss = Loss(
        what="correlations and origin",
        why="the table has sigmas, but no covariances, no verdict and no provenance. Keep calibration.yaml.",
    )
    return Export(files={"calibration.csv": "\n".join(rows) + "\n"}, losses=(loss,))
