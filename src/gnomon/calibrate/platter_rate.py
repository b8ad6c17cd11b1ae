"""A video of a turning platter -> its rate.

open the video -> reduce its images -> find and follow what repeats itself -> PlatterRate
"""

from os import PathLike
from pathlib import Path

from ..detect.platter.rate import PlatterRate, platter_rate
from ..errors import DetectionError, RecordingError
from ..progress import Progress
from ..readers.images.image_files import video_place
from ..readers.images.image_recording import holds_images, open_images
from ..readers.recordings import ReadLog
from ..recording.recording import ImageStream
from ..units import Units


def rate_from_video(
    path: str | PathLike[str], nominal_rad_s: float | None = None, progress: Progress | None = None
) -> PlatterRate:
    """Measure how fast a platter turns in a video of it, by the periodicity of the picture.

    The camera is at rest and sees the platter from anywhere above; a mark on the platter helps, but any print will do.
    The platter may start and stop, and be out of sight for a while.

    Parameters
    ----------
    path : a video that PyAV opens, with a table of timestamps beside it where there is one; a folder of images; a bag
    nominal_rad_s : what the rate should be, within 10 %; needed only where the picture leaves several rates open
    progress : called with a sentence from time to time

    Raises
    ------
    RecordingError
        If the video cannot be read.
    DetectionError
        If nothing moves in it, or nothing repeats itself for three turns, or the rate is not clear.
    OptionError
        If the nominal rate is not positive.
    """
    place = Path(path)
    try:
        return platter_rate(_stream(place), nominal_rad_s, progress)
    except DetectionError as error:
        raise DetectionError(f"{place.name}: {error}") from None


def _stream(place: Path) -> ImageStream:
    """Return the images; of a video without what lies beside it, but for a table of its timestamps."""
    from ..readers.images.image_files import is_video
    from ..readers.images.video import video_stream  # PyAV takes its time

    if not place.exists():
        raise RecordingError(f"{place}: there is no such file or folder. Check the path.")
    try:
        if is_video(place):
            return video_stream("cam0", video_place(place), ReadLog(units=Units()))
        if holds_images(place):
            return open_images(place, need_imu=False).streams["cam0"]
    except OSError as error:
        raise RecordingError(f"{place}: cannot be read ({error.strerror or error}). Check its permissions.") from None
    raise RecordingError(
        f"{place}: this is no video, or it is damaged. Expected a video of the turning platter, such as an .mp4, .mkv "
        "or .avi of a webcam."
    )
