"""Whether a file is a video, by its content: most files are none by their first bytes, without PyAV being loaded."""

from pathlib import Path

from ..files import is_mp4_head

_HEAD = 4096
_TEXT_MAGIC = b"YUV4MPEG2"  # the only video that begins as text
_NO_VIDEO = (b"\x1f\x8b", b"PK\x03\x04", b"#ROSBAG", b"\x89MCAP", b"SQLite format 3", b"\x93NUMPY", b"%PDF")
_IMAGES = ("image2", "_pipe")


def is_video(path: Path) -> bool:
    """Tell by its content whether a file is a video."""
    try:
        if not path.is_file():
            return False
        with path.open("rb") as file:
            head = file.read(_HEAD)
    except OSError:
        return False
    text = b"\0" not in head and not head.startswith(_TEXT_MAGIC)
    if text or head.startswith(_NO_VIDEO):
        return False
    return is_mp4_head(head) or _opens_as_video(path)


def _opens_as_video(path: Path) -> bool:
    import av  # takes its time
    from av.error import FFmpegError

    try:
        with av.open(str(path)) as container:
            return bool(container.streams.video) and not container.format.name.endswith(_IMAGES)
    except (FFmpegError, OSError, ValueError):
        return False
