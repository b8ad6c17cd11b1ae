"""What was measured: samples, frames, poses, as recorded, with their timestamps and their unit."""

from .recording import (
    CameraFrames,
    FrameQuality,
    KnownRig,
    Piece,
    Recording,
    Source,
    recorded_hashes,
    shared_sources,
)
from .samples import (
    Floats,
    ImuSamples,
    Integers,
    Poses,
    TemperatureSamples,
    TriadSamples,
    close_gaps,
    frozen_array,
    kept_with_array,
    measurable_numbers,
    smallest_steps,
    usual_step,
)

__all__ = [
    "CameraFrames",
    "Floats",
    "FrameQuality",
    "ImuSamples",
    "Integers",
    "KnownRig",
    "Piece",
    "Poses",
    "Recording",
    "Source",
    "TemperatureSamples",
    "TriadSamples",
    "close_gaps",
    "frozen_array",
    "kept_with_array",
    "measurable_numbers",
    "recorded_hashes",
    "shared_sources",
    "smallest_steps",
    "usual_step",
]
