"""What is said of a GoPro's telemetry: how well its stamps are known, and what matters for the images."""

import numpy as np

from .gpmf_clock import NOMINAL_PAYLOAD_S, Clock
from .gpmf_streams import Block, Device

_STABILISED_RAD = np.radians(0.2)


def notes_on_clock(clock: Clock, blocks: tuple[Block, ...], sensor: str, name: str, *, timed: bool) -> list[str]:
    """Say where the stamps of a triad come from, how well they are known, and how warm the sensor was.

    Parameters
    ----------
    clock, blocks : of the triad
    sensor, name : the triad and the file, for the sentences
    timed : whether the container states the times of payloads
    """
    count = len(blocks)
    stray = f" (largest deviation {1e3 * clock.stray_s:.2g} ms)" if count > 2 else ""
    if clock.stamped and count > 1:
        how = f"an even clock through the camera's stamps of {count} payloads{stray}"
    elif timed:
        how = f"spread evenly over {count} payloads of the video, whose samples have no stamps{stray}"
    else:
        how = f"as if each payload took {NOMINAL_PAYLOAD_S:g} s, which nothing states: off by 1 % or so{stray}"
    notes = [f"{name}: {sensor} at {clock.rate_hz:.5g} Hz, {how}."]
    if clock.lost:
        notes.append(f"{name}: {clock.lost} samples of the {sensor} are missing between payloads, as its count says.")
    degrees = np.array([block.temperature for block in blocks])
    if sensor == "gyroscope" and np.isfinite(degrees).any():
        low, high = float(np.nanmin(degrees)), float(np.nanmax(degrees))
        notes.append(f"{name}: its sensor was at {low:.1f} to {high:.1f} degrees Celsius.")
    return notes


def notes_on_video(device: Device, name: str, *, video: bool) -> list[str]:
    """Say what matters for the images: electronic stabilisation, and the time to read out the sensor."""
    notes: list[str] = []
    turned = [block.values for block in device.of("IORI") if block.values.shape[1] == 4]
    if video and turned:  # quaternions of the image to the body, the real part first
        vector = np.linalg.norm(np.concatenate(turned)[:, 1:], axis=1)
        angle = float(2 * np.arcsin(np.clip(vector.max(), 0, 1)))
        if angle > _STABILISED_RAD:
            notes.append(
                f"{name}: the images were turned by up to {np.degrees(angle):.1f} degrees against the camera (IORI): "
                "stabilisation (HyperSmooth) was on. Images like that fit no IMU; switch it off to calibrate a camera."
            )
    read_out = device.of("SROT")
    if video and read_out:
        ms = float(np.median(np.concatenate([block.values.ravel() for block in read_out])))
        notes.append(f"{name}: rolling shutter; the camera states {ms:.3g} ms to read out the sensor (SROT).")
    return notes
