"""All ways by which files of others come into gnomon, as targets of the fuzzers."""

from .camera_targets import CAMERAS
from .promise import Target
from .sample_targets import SAMPLES
from .structured_targets import STRUCTURED

TARGETS: dict[str, Target] = {target.name: target for target in (*SAMPLES, *CAMERAS, *STRUCTURED)}
