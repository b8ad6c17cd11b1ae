"""Record cameras and IMU of an OAK-D as a folder that gnomon reads: `python oak_d.py rig`; stop it with Ctrl-C.

It needs DepthAI 3 (`pip install depthai`) and OpenCV. Images go into rig/cam0, cam1, ..., listed with their timestamps
in data.csv beside them, samples into rig/imu0-acc.csv and rig/imu0-gyr.csv. All timestamps are of the device's clock.

It was not run on a device: a test runs it against a DepthAI that is played.
"""

import argparse
import contextlib
import time
from datetime import timedelta
from pathlib import Path
from typing import Any

import cv2
import depthai as dai

IMU_HZ = 400


def nanoseconds(moment: timedelta) -> int:
    """Return a timestamp of DepthAI, which has whole microseconds, in ns."""
    return moment // timedelta(microseconds=1) * 1000


class Table:
    """A CSV file with one row for each timestamp."""

    def __init__(self, path: Path, header: str) -> None:
        path.parent.mkdir(parents=True, exist_ok=True)
        self.file = path.open("x", encoding="utf-8")
        self.file.write(header + "\n")
        self.last = -1

    def add(self, t_ns: int, *values: object) -> None:
        """Write a row, but not of the timestamp of the row before: a packet may repeat the slower sensor's report."""
        if t_ns != self.last:
            self.file.write(",".join(map(str, (t_ns, *values))) + "\n")
        self.last = t_ns


def record(
    folder: Path, sockets: list[str], size: tuple[int, int], fps: float, exposure: tuple[int, int] | None
) -> None:
    """Record until Ctrl-C, or until the device is gone; exposure in microseconds and ISO, None for automatic."""
    acc = Table(folder / "imu0-acc.csv", "t [ns],ax [m/s^2],ay,az")
    gyr = Table(folder / "imu0-gyr.csv", "t [ns],gx [rad/s],gy,gz")
    lists = [Table(folder / f"cam{i}" / "data.csv", "timestamp [ns],filename") for i in range(len(sockets))]
    with contextlib.suppress(KeyboardInterrupt), dai.Pipeline() as pipeline:
        imu = pipeline.create(dai.node.IMU)
        imu.enableIMUSensor([dai.IMUSensor.ACCELEROMETER_RAW, dai.IMUSensor.GYROSCOPE_RAW], IMU_HZ)
        imu.setBatchReportThreshold(10)
        imu.setMaxBatchReports(20)
        samples = imu.out.createOutputQueue(maxSize=200, blocking=True)
        cameras = [pipeline.create(dai.node.Camera).build(getattr(dai.CameraBoardSocket, name)) for name in sockets]
        for camera in cameras if exposure else ():
            camera.initialControl.setManualExposure(*exposure)
        images = [camera.requestOutput(size, fps=fps).createOutputQueue(maxSize=30) for camera in cameras]
        pipeline.start()
        while pipeline.isRunning():
            for message in samples.tryGetAll():
                for packet in message.packets:
                    add_sample(acc, packet.acceleroMeter)
                    add_sample(gyr, packet.gyroscope)
            for i, queue in enumerate(images):
                for frame in queue.tryGetAll():
                    t_ns = nanoseconds(frame.getTimestampDevice(dai.CameraExposureOffset.MIDDLE))
                    cv2.imwrite(str(folder / f"cam{i}" / f"{t_ns}.png"), frame.getCvFrame())
                    lists[i].add(t_ns, f"{t_ns}.png")
            time.sleep(0.002)
    for table in (acc, gyr, *lists):
        table.file.close()


def add_sample(table: Table, report: Any) -> None:
    """Write what one sensor measured."""
    table.add(nanoseconds(report.getTimestampDevice()), report.x, report.y, report.z)


def main() -> None:
    """Read the command line and record."""
    parser = argparse.ArgumentParser(description="Record cameras and IMU of an OAK-D into a folder; stop with Ctrl-C.")
    parser.add_argument("folder", type=Path, help="a new folder")
    parser.add_argument("--sockets", nargs="*", default=["CAM_B"], help="cameras; none for the IMU alone")
    parser.add_argument("--size", nargs=2, type=int, default=[640, 400], help="width and height of the images")
    parser.add_argument("--fps", type=float, default=20.0)
    parser.add_argument("--exposure-us", type=int, help="exposure time, such as 5000 (default: automatic)")
    parser.add_argument("--iso", type=int, default=800, help="sensitivity, with --exposure-us")
    given = parser.parse_args()
    exposure = (given.exposure_us, given.iso) if given.exposure_us else None
    record(given.folder, given.sockets, tuple(given.size), given.fps, exposure)


if __name__ == "__main__":
    main()
