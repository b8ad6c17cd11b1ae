"""A calibration as a phase of an OpenHTF test: the numbers become measurements, the calibration file an attachment.

    pip install gnomon openhtf
    python examples/openhtf_calibration.py recording.csv SN0042

The record of the test is a JSON file here; OpenHTF has other outputs. The exit code is 0 where the test passed.
"""

import sys
from pathlib import Path

import numpy as np
import openhtf as htf
from openhtf.output.callbacks import json_factory

import gnomon


def calibration_phase(recording: str, output: Path) -> htf.PhaseDescriptor:
    """Return the phase that calibrates a recording, judges what it found, and keeps it in a file."""

    @htf.measures(
        htf.Measurement("verdict").with_validator(lambda verdict: verdict in ("pass", "warn")),
        htf.Measurement("accelerometer_bias").with_dimensions("axis").doc("m/s^2, or the unit of the samples"),
        htf.Measurement("gyroscope_bias").with_dimensions("axis").doc("rad/s, or the unit of the samples"),
        htf.Measurement("gyroscope_scale_sigma").in_range(maximum=1e-3).doc("the worst axis, relative"),
    )
    def calibrate(test: htf.TestApi) -> None:
        result = gnomon.calibrate_imu(gnomon.read(recording))
        imu = result.calibration.imus["imu0"]
        test.measurements.verdict = result.calibration.verdict
        for axis, accelerometer, gyroscope in zip("xyz", imu.accelerometer.bias, imu.gyroscope.bias, strict=True):
            test.measurements.accelerometer_bias[axis] = float(accelerometer)
            test.measurements.gyroscope_bias[axis] = float(gyroscope)
        sigma = np.diag(result.calibration.sigma("imu0.gyroscope.sensitivity") / imu.gyroscope.sensitivity)
        test.measurements.gyroscope_scale_sigma = float(np.abs(sigma).max())
        gnomon.save(result, output)
        test.attach_from_file(str(output))

    return calibrate


if __name__ == "__main__":
    source, serial = sys.argv[1:]
    station = htf.Test(calibration_phase(source, Path(f"{serial}.yaml")), test_name="IMU calibration")
    station.add_output_callbacks(json_factory.OutputToJSON("{dut_id}.{start_time_millis}.json", indent=2))
    sys.exit(not station.execute(test_start=lambda: serial))
