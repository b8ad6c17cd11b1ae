"""What the recipes are called with: a value of another kind gets an error that says how to make the right one."""

from ..errors import OptionError
from ..models.target import Target
from ..recording import Recording

_READ = {
    "calibrate_imu": 'gnomon.calibrate_imu(gnomon.read("recording.csv"))',
    "calibrate_magnetometer": 'gnomon.calibrate_magnetometer(gnomon.read("recording.csv"))',
    "calibrate_turntable": 'gnomon.calibrate_turntable([gnomon.read_turntable("disc.csv")], rates)',
    "calibrate_cameras": 'gnomon.calibrate_cameras(*gnomon.read_camera_views("images", target="target.yaml"))',
    "calibrate_camera_imu": "gnomon.calibrate_camera_imu(*gnomon.read_camera_imu("
    '"rig.bag", cam="camchain.yaml", imu="imu.yaml", target="target.yaml"))',
}


def check_arguments(function: str, *values: object) -> None:
    """Check that a recipe is given recordings, and a board where it takes one as the last.

    Raises
    ------
    OptionError
        If one is something else, such as the path of a file.
    """
    kinds = (Recording, Target) if function in ("calibrate_cameras", "calibrate_camera_imu") else (Recording,)
    for number, value in enumerate(values):
        kind = kinds[min(number, len(kinds) - 1)]
        if not isinstance(value, kind):
            shown = f"{type(value).__name__} {value!r:.60}" if isinstance(value, str) else type(value).__name__
            raise OptionError(
                f"{function} takes a {kind.__name__}, and was given a {shown}. Read it first: {_READ[function]}."
            )
