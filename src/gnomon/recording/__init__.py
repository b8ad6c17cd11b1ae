"""What was measured: samples, frames, poses, as recorded, with their timestamps and their unit."""

from .arrays import (
    Floats,
    Integers,
    close_gaps,
    frozen_array,
    kept_with_array,
    measurable_numbers,
    smallest_steps,
    usual_step,
)
from .frames import CameraFrames, FrameQuality, KnownRig
from .recording import Recording
from .samples import ImuSamples, Poses, TemperatureSamples, TriadSamples
from .sources import Piece, Source, recorded_hashes, shared_sources

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
