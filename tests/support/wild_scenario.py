"""Wild scenarios of an IMU alone: sensor, motion, converter and timestamps."""

import numpy as np

from gnomon.simulate.scenarios.recorded import Scenario

from .wild import log_uniform

_MOST_SAMPLES = 60_000


def wild_scenario(rng: np.random.Generator) -> Scenario:
    """Draw a scenario in which anything may be odd."""
    counts = rng.random() < 0.6
    poses = int(rng.integers(3, 10)) if rng.random() < 0.1 else int(rng.integers(10, 80))
    hold = log_uniform(rng, 0.3, 20.0) if rng.random() < 0.2 else log_uniform(rng, 1.5, 6.0)
    move = log_uniform(rng, 0.3, 3.0)
    t_init_s = log_uniform(rng, 0.3, 60.0)
    duration_s = t_init_s + poses * (1.3 * hold + 1.3 * move)
    rate_hz = min(log_uniform(rng, 10.0, 2000.0), _MOST_SAMPLES / duration_s)
    # Counts have no known scale nor zero; what is far off in m/s^2 is refused at once.
    far = counts or rng.random() < 0.15
    scales = [_scales(rng) if far else (0.95, 1.05), _scales(rng)]
    bias = [log_uniform(rng, 0.01, 50.0 if far else 1.0), log_uniform(rng, 1e-3, 5.0)]
    room = log_uniform(rng, 0.5, 1.0) if rng.random() < 0.12 else log_uniform(rng, 1.3, 8.0)
    return Scenario(
        style="thesis" if rng.random() < 0.04 else "hand",
        intervals=poses,
        t_init_s=t_init_s,
        hold_s=(hold, 1.5 * hold),
        motion_s=(move, 1.6 * move),
        rate_hz=rate_hz,
        gyroscope_rate_hz=rate_hz * float(rng.uniform(0.3, 1.0)) if rng.random() < 0.15 else None,
        gravity=float(rng.uniform(9.77, 9.83)),
        units="raw" if counts else str(rng.choice(["si", "g deg/s", "mg mdeg/s"])),
        bits=int(rng.integers(8, 25)) if rng.random() < 0.7 else None,
        accelerometer_range=room * (18.0 / scales[0][0] + bias[0]),
        gyroscope_range=room * (9.0 / scales[1][0] / move + bias[1]),
        accelerometer_misalignment=log_uniform(rng, 1e-3, 0.5),
        gyroscope_misalignment=log_uniform(rng, 1e-3, 0.5),
        accelerometer_scale=scales[0],
        gyroscope_scale=scales[1],
        accelerometer_bias=bias[0],
        gyroscope_bias=bias[1],
        g_sensitivity=log_uniform(rng, 1e-5, 1e-2) if rng.random() < 0.5 else 0.0,
        accelerometer_noise_density=log_uniform(rng, 1e-5, 2e-2),
        gyroscope_noise_density=log_uniform(rng, 1e-6, 5e-3),
        gyroscope_bias_walk=log_uniform(rng, 1e-6, 1e-3) if rng.random() < 0.4 else 0.0,
        stamp_jitter_s=log_uniform(rng, 1e-4, 0.6) / rate_hz if rng.random() < 0.15 else 0.0,
        stamp_resolution_s=log_uniform(rng, 1e-4, 0.02) if rng.random() < 0.15 else 0.0,
        dropped=log_uniform(rng, 1e-3, 0.4) if rng.random() < 0.15 else 0.0,
    )


def _scales(rng: np.random.Generator) -> tuple[float, float]:
    if rng.random() < 0.5:
        return (0.97, 1.03)
    if rng.random() < 0.3:
        return (0.2, 5.0)
    middle = log_uniform(rng, 0.25, 4.0)
    return (0.8 * middle, 1.25 * middle)
