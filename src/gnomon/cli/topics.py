"""Topics of a bag as they are stated on the command line."""

import re
from collections.abc import Sequence

from ..errors import OptionError


def topics_of(stated: Sequence[str]) -> dict[str, str]:
    """Return the topics of cameras and IMUs by name, from NAME=TOPIC.

    Raises
    ------
    OptionError
        If one is not of this form, or stands twice.

    Examples
    --------
    >>> topics_of(["cam0=/left/image_raw", "imu0=/imu/data"])
    {'cam0': '/left/image_raw', 'imu0': '/imu/data'}
    """
    topics: dict[str, str] = {}
    for text in stated:
        name, equals, topic = text.partition("=")
        if not (equals and topic and re.fullmatch(r"(cam|imu)\d+", name)):
            raise OptionError(f"--topics {text}: expected NAME=TOPIC, such as cam0=/cam0/image_raw or imu0=/imu0.")
        if name in topics:
            raise OptionError(f"--topics {text}: {name} is stated twice.")
        topics[name] = topic
    return topics
