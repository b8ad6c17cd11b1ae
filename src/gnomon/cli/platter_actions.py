"""What the commands about videos of a turning platter do."""

from dataclasses import asdict
from math import degrees, pi
from typing import TYPE_CHECKING, Any

from .places import result_folder
from .platter_command import Rate, SimulatePlatterVideo
from .results import USABLE
from .terminal import Terminal

if TYPE_CHECKING:
    from ..detect.platter.rate import PlatterRate


def rate(command: Rate, terminal: Terminal) -> int:
    """Measure the rate of a platter, say it, and return the exit code."""
    from ..calibrate.platter_rate import rate_from_video
    from . import summary

    found = rate_from_video(command.video, command.nominal_rad_s, terminal.progress)
    terminal.close()
    value, sigma, turns_hz = found.rate_rad_s, found.sigma_rad_s, found.rate_rad_s / (2 * pi)
    start, stop = found.steady_s
    terminal.say(f"rate          {_with_sigma(30 / pi * value, 30 / pi * sigma)} rpm")
    terminal.say(f"              {_with_sigma(value, sigma)} rad/s")
    terminal.say(f"              {_with_sigma(degrees(value), degrees(sigma))} deg/s")
    terminal.say(f"relative      {sigma / value:.1e} (1 sigma), of it the clock of the frames {found.clock:.0e}")
    terminal.say(f"steady part   {start:.1f} to {stop:.1f} s of {found.duration_s:.1f} s, {found.turns:.1f} turns")
    terminal.say(f"frames        {found.frames_used} of {found.frames} used, {found.frame_rate_hz:.4g} per second")
    terminal.say(f"one turn      {1 / turns_hz:.6g} s")
    terminal.say("\n" + "\n".join(summary.advice(found.findings, good=True)))
    terminal.document(rate_document(found))
    return USABLE


def _with_sigma(value: float, sigma: float) -> str:
    import numpy as np

    from .summary import common_decimals

    decimals = common_decimals(np.array([sigma]))
    return f"{value:.{decimals}f} +- {sigma:.{decimals}f}"


def rate_document(found: "PlatterRate") -> dict[str, Any]:
    """Return what a program is told about the rate."""
    return {
        "exit_code": USABLE,
        "rate_rad_s": found.rate_rad_s,
        "sigma_rad_s": found.sigma_rad_s,
        "rate_rpm": 30 / pi * found.rate_rad_s,
        "sigma_rpm": 30 / pi * found.sigma_rad_s,
        "clock_relative": found.clock,
        "turns": found.turns,
        "steady_s": found.steady_s,
        "duration_s": found.duration_s,
        "frames": found.frames,
        "frames_used": found.frames_used,
        "frame_rate_hz": found.frame_rate_hz,
        "repetitions_per_turn": float(found.per_turn),
        "drift_rad_s": found.drift_rad_s[0],
        "drift_sigma_rad_s": found.drift_rad_s[1],
        "findings": [asdict(finding) for finding in found.findings],
    }


def simulate_platter_video(command: SimulatePlatterVideo, terminal: Terminal) -> int:
    """Draw and write a video, say its true rate, and return the exit code."""
    from ..simulate.platter_video import simulate_platter_video as simulated
    from ..writers.video import save_video

    terminal.progress("drawing the frames")
    video = simulated(command.scenario, command.seed)
    with result_folder(command.output.parent, own=()) as staging:
        path = staging / command.output.name
        frames = save_video(path, video.images(), video.t_ns, rate_hz=command.scenario.frame_rate_hz)
    terminal.close()
    start, stop = video.steady_s
    terminal.say(f"video         {command.output}, {frames} frames")
    terminal.say(f"true rate     {30 / pi * video.rate_rad_s:.6f} rpm from {start:.1f} to {stop:.1f} s")
    terminal.document(
        {
            "video": str(command.output),
            "frames": frames,
            "true_rate_rad_s": video.rate_rad_s,
            "steady_s": video.steady_s,
        }
    )
    return USABLE
