"""The Python scripts of examples/devices, run against libraries that are played."""

import runpy
import sys
from datetime import timedelta
from pathlib import Path
from types import SimpleNamespace as Namespace

import numpy as np
import pytest

from field_logs import samples
from gnomon import read
from gnomon.readers.images.image_recording import open_images

OAK = Path(__file__).parents[3] / "examples" / "devices" / "oak_d.py"
SHUTTER_S = 0.004
"""By which the middle of the exposure is before the timestamp that stands without a place in the exposure."""


class Report:
    def __init__(self, t_us, vector):
        self.t_us = t_us
        self.x, self.y, self.z = map(float, vector)

    def getTimestampDevice(self):
        return timedelta(microseconds=int(self.t_us))


class Frame(Report):
    def getTimestampDevice(self, offset="end"):
        return timedelta(microseconds=int(self.t_us)) - timedelta(seconds=SHUTTER_S * (offset == "middle"))

    def getCvFrame(self):
        return np.full((40, 64), 100, np.uint8)


class PlayedPipeline:
    """A pipeline of DepthAI 3 that sends all it has, in two messages of each queue, and is then interrupted."""

    def __init__(self, packets, frames, stop):
        self.sent = {"imu": [Namespace(packets=packets[:50]), Namespace(packets=packets[50:])], "camera": frames}
        self.stop, self.rounds, self.exposures = stop, 0, []

    def __enter__(self):
        return self

    def __exit__(self, *_):
        return None

    def create(self, kind):
        queue = Namespace(tryGetAll=lambda: [self.sent[kind].pop(0)] if self.sent[kind] else [])
        output = Namespace(createOutputQueue=lambda **_: queue)
        made = Namespace(out=output, requestOutput=lambda size, fps: output)
        made.build = lambda socket: made
        made.initialControl = Namespace(setManualExposure=lambda *exposure: self.exposures.append(exposure))
        for name in ("enableIMUSensor", "setBatchReportThreshold", "setMaxBatchReports"):
            setattr(made, name, lambda *_: None)
        return made

    def start(self):
        pass

    def isRunning(self):
        self.rounds += 1
        if self.rounds > 12:
            if self.stop is not None:
                raise self.stop
            return False
        return True


@pytest.mark.parametrize("stop", [None, KeyboardInterrupt()], ids=["unplugged", "Ctrl-C"])
def test_an_oak_d_is_recorded_as_a_folder_that_is_read(stop, tmp_path, monkeypatch):
    truth = samples()
    t_us = np.round(1e6 * truth.t).astype(np.int64) + 12_000_000  # soon after switching on: few digits
    slower = np.arange(len(t_us)) // 2 * 2  # each report of the gyroscope comes twice
    packets = [
        Namespace(acceleroMeter=Report(t_us[i], truth.force[i]), gyroscope=Report(t_us[j], truth.rate[j]))
        for i, j in enumerate(slower)
    ]
    frames = [Frame(t, np.zeros(3)) for t in t_us[: 10 * 20 : 20]]
    pipeline = PlayedPipeline(packets, frames, stop)
    played = Namespace(
        Pipeline=lambda: pipeline,
        node=Namespace(IMU="imu", Camera="camera"),
        IMUSensor=Namespace(ACCELEROMETER_RAW=1, GYROSCOPE_RAW=2),
        CameraBoardSocket=Namespace(CAM_B="left"),
        CameraExposureOffset=Namespace(MIDDLE="middle"),
    )
    monkeypatch.setitem(sys.modules, "depthai", played)
    monkeypatch.setattr(sys, "argv", ["oak_d.py", str(tmp_path / "rig"), "--exposure-us", "5000"])
    runpy.run_path(str(OAK), run_name="__main__")
    assert pipeline.exposures == [(5000, 800)]
    imu = read(tmp_path / "rig" / "imu0-acc.csv", tmp_path / "rig" / "imu0-gyr.csv").imus["imu0"]
    np.testing.assert_array_equal(imu.accelerometer.t_ns, 1000 * t_us)
    np.testing.assert_allclose(imu.accelerometer.values, truth.force)
    np.testing.assert_array_equal(imu.gyroscope.t_ns, 1000 * t_us[::2])
    np.testing.assert_allclose(imu.gyroscope.values, truth.rate[::2])
    assert (imu.accelerometer.unit, imu.gyroscope.unit) == ("m/s^2", "rad/s")
    recorded = open_images(tmp_path / "rig")
    t_ns = [frame.t_ns for frame in recorded.streams["cam0"].frames([])]
    np.testing.assert_array_equal(t_ns, 1000 * (t_us[:200:20] - 4000))
    np.testing.assert_array_equal(recorded.imus["imu0"].gyroscope.t_ns, 1000 * t_us[::2])
