"""Simulated videos of a turning platter that are hard in one way each, small enough for tests."""

from math import pi

from gnomon.simulate.scenarios.turntable import PlatterScenario

RPM = 2 * pi / 60
SMALL = {"width": 200, "height": 150, "noise_grey": 4.0}

HARD = {
    "starts and stops": {"start_s": 6.0, "spin_up_s": 1.5, "stop_s": 50.0},
    "rests for half of it": {"start_s": 32.0, "spin_up_s": 0.4},
    "hidden by a hand": {"hidden": ((10.0, 17.0), (30.0, 33.0), (50.0, 51.0))},
    "mark leaves the picture": {"offset": (0.9, 0.5)},
    "half out of view": {"offset": (1.3, 0.9), "radius": 1.2},
    "somebody walks behind it": {"background": 1.0},
    "pale print before somebody": {"background": 1.0, "texture": 0.3, "mark": False, "sensor": False},
    "seen at 60 degrees": {"tilt_deg": 60.0},
    "print of two halves": {"symmetry": 2},
    "print of twelve parts": {"symmetry": 12, "mark": False, "sensor": False},
    "a mark alone": {"texture": 0.0, "sensor": False},
    "no mark": {"mark": False, "sensor": False},
    "blurred": {"exposure_s": 0.066, "rate_rad_s": 45 * RPM},
    "five frames a turn": {"rate_rad_s": 180 * RPM, "exposure_s": 0.01},
    "nominal times": {"stamps": "nominal", "clock_error": 7e-4},
    "frames missing, unnoticed": {"stamps": "nominal", "dropped": 0.02},
    "frames missing": {"dropped": 0.1},
    "flickering": {"flicker": 0.15},
    "dark and noisy": {"noise_grey": 20.0},
    "uneven speed": {"wow": 0.01, "flutter": 0.02},
    "rising speed": {"drift": 0.01},
    "turns the other way at 33 rpm": {"rate_rad_s": -100 / 3 * RPM, "frame_rate_hz": 30.0, "duration_s": 40.0},
}
"""What is hard about it -> options of the scenario."""

HOPELESS = {
    "at rest": ({"start_s": 100.0}, "nothing moves"),
    "looks the same all around": ({"texture": 0.0, "mark": False, "sensor": False}, "nothing moves"),
    "swings": ({"motion": "swing"}, "not seen to be that of a turning platter|nothing in this video"),
    "blinks": ({"motion": "blink"}, "not seen to be that of a turning platter|nothing in this video"),
    "two turns": ({"duration_s": 7.5}, "turns are needed|nothing in this video|not seen to be that of a turning"),
    "one frame a second": ({"rate_rad_s": 78 * RPM, "frame_rate_hz": 1.0, "exposure_s": 0.01, "jitter_s": 0.0}, "Give"),
    "five frames a second": ({"frame_rate_hz": 5.0, "jitter_s": 0.0}, "16 rpm, 284 rpm"),
    "only somebody walking": (
        {"texture": 0.0, "mark": False, "sensor": False, "background": 1.0},
        "nothing in this video|not seen to be",
    ),
}
"""What is wrong with it -> options of the scenario, and words of the message."""


def scenario(**options):
    """Return a small video, 16 rpm at 15 frames per second where nothing else is said."""
    return PlatterScenario(**(SMALL | options))
