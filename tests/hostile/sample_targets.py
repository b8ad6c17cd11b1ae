"""Targets: tables of samples and of poses, NPZ files, folders, logs of phones and of cameras."""

import gzip
import io
import zipfile
from collections.abc import Callable
from functools import cache
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
from scipy.io import savemat

import field_logs
import gnomon
from gnomon.live.recorder import is_printable
from gnomon.live.sources import PushSource
from gnomon.readers.samples.stream import open_stream
from gnomon.readers.samples.stream_text import ArrivingTable
from gnomon.readers.samples.turntable_files import turntable_files
from gnomon.units import Units
from gpmf_files import payloads_of, telemetry_only
from phone_logs import metadata, motion, phyphox, sensor_logger, zipped

from .promise import Target

SI = Units(accelerometer="m/s^2", gyroscope="rad/s", magnetometer="uT")
NAMES = "timestamp [ns],wx [rad/s],wy,wz,ax [m/s^2],ay,az"


PUSHED = (
    b'{"payload": [{"name": "gyroscope", "time": 5, "values": {"x": 1, "y": 2, "z": 3}}, '
    b'{"name": "totalacceleration", "time": 6, "values": {"x": 1.5, "y": 2.5, "z": 9.5}}]}'
)


def arrived(data: bytes) -> int:
    """Return how many samples are in lines that arrive in two parts, as a guided capture takes them."""
    lines = [line + b"\n" for line in data.split(b"\n") if is_printable(line)]
    table = ArrivingTable("samples.log", b"".join(lines[:20]), Units())
    blocks = [table.first, table.samples_in(b"".join(line for line in lines[20:] if table.is_row(line)))]
    return sum(len(samples) for block in blocks for samples in block.values())


@cache
def moved(count: int = 30) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    return motion(count, 0.01)


def table(header: str = NAMES, *, separator: str = ",", magnetometer: bool = False, end: str = "\n") -> bytes:
    t, force, rate = moved()
    columns = [rate, force] + ([force * 4] if magnetometer else [])
    rows = np.column_stack(columns)
    stamps = 1_600_000_000_000_000_000 + np.rint(t * 1e9).astype(np.int64)
    lines = [separator.join([str(s), *(f"{v:.6f}" for v in row)]) for s, row in zip(stamps.tolist(), rows, strict=True)]
    return end.join([*([header] if header else []), *lines, ""]).encode()


def poses(header: str) -> bytes:
    rng = np.random.default_rng(3)
    rows = rng.normal(size=(9, 3))
    rows *= 9.8 / np.linalg.norm(rows, axis=1)[:, None]
    lines = [",".join(f"{v:.6f}" for v in row) for row in rows]
    return "\n".join([header, *lines, ""]).encode()


def tables() -> list[bytes]:
    plain = table("")
    return [
        table(), table(f"{NAMES},mx [uT],my,mz", magnetometer=True), plain, table("", separator=" "),
        table("", separator=";").replace(b".", b","), gzip.compress(table()), table(end="\r\n"),
        b"# Fs: 100\n" + b"\n".join(line.partition(b",")[2] for line in plain.splitlines()) + b"\n",
        poses("ax,ay,az"), b"Time,%time,field.header.stamp\n" + plain,
    ]  # fmt: skip


def stated() -> list[bytes]:
    """Return tables that state their scales, their rate, or the order of their columns."""
    rows = b"".join(b"%d,39,86,183,-11,-62,-29\n" % i for i in range(9))
    novatel = (
        b"%RAWIMUSA,2209,491612.254;2209,491612.253588,ea5afe00,329303960,-2512321,4410363,309705,607017,-1009773"
        b"*1fb76c28\n"
    )
    return [
        b"GYROFLOW IMU LOG\nversion,1.3\ntscale,0.001\ngscale,0.0012\nascale,0.0004\nt,gx,gy,gz,ax,ay,az\n" + rows,
        b"1572606921.0, 1572606921.0, 1572606921.0\n32.0, 32.0, 32.0\n" + b"1,-62,-29\n" * 9, novatel * 4,
    ]  # fmt: skip


def matlab_files() -> list[bytes]:
    t, force, rate = moved()
    made: list[bytes] = []
    for content, compressed in (
        ({"t": t, "acc": force, "gyro": rate}, False),
        ({"log": {"a": force, "Fs": 100.0}}, True),
    ):
        file = io.BytesIO()
        savemat(file, content, do_compression=compressed)
        made.append(file.getvalue())
    return made


def npz(compressed: bool, **changes: Any) -> bytes:
    t, force, rate = moved()
    arrays = {"t_ns": np.rint(t * 1e9).astype(np.int64), "accelerometer": force, "gyroscope": rate, **changes}
    file = io.BytesIO()
    (np.savez_compressed if compressed else np.savez)(file, **{k: v for k, v in arrays.items() if v is not None})
    return file.getvalue()


def archives() -> list[bytes]:
    t, force, rate = moved()
    units = {"unit_accelerometer": np.array("m/s^2"), "unit_gyroscope": np.array("rad/s")}
    several = {"imu1.t_s": t, "imu1.accelerometer": force, "imu1.gyroscope": rate, **units}
    others = {"t_ns": None, "accelerometer": None, "gyroscope": None}
    return [
        npz(compressed=False), npz(compressed=True, **units), npz(compressed=False, **several),
        npz(compressed=False, t_ns=None, rate_hz=np.array(100.0), magnetometer=force),
        npz(compressed=False, **others, acc=force, gyro=rate, ts=t, t_acc=t, t_gyro=t),
        npz(compressed=False, accelerometer=np.asfortranarray(force)),
    ]  # fmt: skip


def streamed(path: Path, **options: Any) -> None:
    """Read everything of a recording block by block."""
    stream = open_stream(path, expected=SI, block_bytes=700, **options)
    for name in ("accelerometer", "gyroscope", "magnetometer"):
        blocks = getattr(stream, name)
        for block in blocks if blocks is not None else ():
            assert block.values.shape == (len(block.t_ns), 3)


def several_ways(*reads: Callable[[Path], Any]) -> Callable[[Path], Any]:
    def read(path: Path) -> None:
        refused: list[gnomon.GnomonError] = []
        for one in reads:
            try:
                one(path)
            except gnomon.GnomonError as error:
                refused.append(error)
        if refused:
            raise refused[0]

    return read


def _phone(kind: str) -> dict[str, bytes]:
    """Return the files that an app exports, by name, and what is packed from them."""
    t, force, rate = motion(60, 0.02)
    with TemporaryDirectory() as folder:
        place = Path(folder)
        if kind == "sensor-logger":
            tables = {"Accelerometer": force - 1, "Gravity": force * 0 + [0, 0, 9.8], "Gyroscope": rate}
            for name, values in tables.items():
                sensor_logger(place / f"{name}.csv", t, values)
            metadata(place, "android")
        else:
            phyphox(place / "Accelerometer.csv", "Acceleration", "m/s^2", t, force)
            phyphox(place / "Gyroscope.csv", "Gyroscope", "rad/s", t, rate)
            (place / "meta").mkdir()
            (place / "meta/device.csv").write_text('"property","value"\n"version","1.1"\n')
        zipped(place, place / "packed.zip")
        return {path.relative_to(place).as_posix(): path.read_bytes() for path in place.rglob("*") if path.is_file()}


phone = cache(_phone)


def phone_folder(kind: str, file: str) -> Target:
    def beside(folder: Path) -> None:
        for name, data in phone(kind).items():
            if not name.endswith(".zip"):
                (folder / name).parent.mkdir(exist_ok=True)
                (folder / name).write_bytes(data)

    return Target(
        name=f"{kind}-folder", file=file, form="text", beside=beside, read=gnomon.read,
        seeds=lambda: [phone(kind)[file]],
    )  # fmt: skip


def _stored(data: bytes) -> bytes:
    """Return a zip with its tables stored, so that damages reach them."""
    file = io.BytesIO()
    with zipfile.ZipFile(io.BytesIO(data)) as packed, zipfile.ZipFile(file, "w") as stored:
        for member in packed.infolist():
            stored.writestr(member.filename, packed.read(member))
    return file.getvalue()


@cache
def telemetry() -> tuple[list[bytes], list[int]]:
    _, force, rate = motion(90, 0.02)
    return payloads_of(force, rate, 50.0)


def _mp4() -> list[bytes]:
    return [telemetry_only(*telemetry())]


def _raw_gpmf() -> list[bytes]:
    payloads, _ = telemetry()
    return [b"".join(payloads), payloads[0]]


def _autopilot(write: Callable[[Path, field_logs.Samples], Path]) -> list[bytes]:
    """Return the log of an autopilot, of a motion of some seconds."""
    whole = field_logs.samples()
    some = field_logs.Samples(whole.t[:60], whole.force[:60], whole.rate[:60], whole.field[:60])
    with TemporaryDirectory() as folder:
        return [write(Path(folder) / "log", some).read_bytes()]


def _beside_poses(folder: Path) -> None:
    for number in range(4):
        (folder / f"pose{number}.csv").write_bytes(table("t_ns,gx,gy,gz,ax,ay,az"))


def _two(folder: Path) -> None:
    gnomon.read(folder / "acc.csv", folder / "gyr.csv")


def _one_triad(part: slice) -> bytes:
    t, force, rate = moved()
    values = np.column_stack([force, rate])[:, part]
    return "".join(f"{s:.3f},{a:.6f},{b:.6f},{c:.6f}\n" for s, (a, b, c) in zip(t, values, strict=True)).encode()


SAMPLES: tuple[Target, ...] = (
    Target(
        name="sample-table", file="rec.csv", form="text", seeds=tables,
        read=lambda folder: several_ways(gnomon.read, gnomon.read_turntable)(folder / "rec.csv"),
    ),
    Target(
        name="sample-table-stated", file="rec.csv", form="text", seeds=lambda: [table(""), table()],
        read=lambda folder: gnomon.read(
            folder / "rec.csv", columns="t gx gy gz ax ay az", units="g deg/s us", rate_hz=100.0
        ),
    ),
    Target(
        name="stream-of-table", file="rec.csv", form="text", seeds=tables,
        read=lambda folder: streamed(folder / "rec.csv"),
    ),
    Target(
        name="lines-that-arrive", file="rec.csv", form="text", seeds=tables,
        read=lambda folder: arrived((folder / "rec.csv").read_bytes()),
    ),
    Target(
        name="pushed-samples", file="push.json", form="json", seeds=lambda: [PUSHED],
        read=lambda folder: PushSource().take_push((folder / "push.json").read_bytes()),
    ),
    Target(
        name="stated-log", file="rec.csv", form="text", seeds=stated,
        read=lambda folder: gnomon.read(folder / "rec.csv"),
    ),
    Target(
        name="pair-of-tables", file="gyr.csv", form="text", seeds=lambda: [_one_triad(slice(3, 6))], read=_two,
        beside=lambda folder: (folder / "acc.csv").write_bytes(_one_triad(slice(3))),
    ),
    Target(
        name="pose-files", file="poses/pose9.csv", form="text", seeds=lambda: [table("t_ns,gx,gy,gz,ax,ay,az")],
        beside=lambda folder: _beside_poses(folder / "poses"),
        read=lambda folder: (gnomon.read(folder / "poses"), turntable_files([folder / "poses"])),
    ),
    Target(
        name="pose-table", file="poses.csv", form="text",
        seeds=lambda: [
            poses("ax,ay,az"), poses("pose,ax [g],ay,az").replace(b"\n", b"\n1,").rstrip(b"1,"),
            b"pose,ax,ay,az,gx,gy,gz,n\n" + b"".join(b"p%d,0.1,0.2,9.8,0,0.01,0.02,100\n" % i for i in range(8)),
        ],
        read=lambda folder: gnomon.read(folder / "poses.csv"),
    ),
    Target(
        name="euroc-imu-folder", file="mav0/imu0/data.csv", form="text", seeds=lambda: [table()],
        read=gnomon.read,
    ),
    Target(
        name="mat", file="rec.mat", seeds=matlab_files, read=lambda folder: gnomon.read(folder / "rec.mat"),
    ),
    Target(
        name="npz", file="rec.npz", seeds=archives, read=lambda folder: gnomon.read(folder / "rec.npz"),
    ),
    Target(
        name="stream-of-npz", file="rec.npz", seeds=archives, read=lambda folder: streamed(folder / "rec.npz"),
    ),
    Target(
        name="phone-zip", file="log.zip", read=lambda folder: gnomon.read(folder / "log.zip"),
        seeds=lambda: [
            made for kind in ("sensor-logger", "phyphox") for data in [phone(kind)["packed.zip"]]
            for made in (data, _stored(data))
        ],
    ),
    phone_folder("sensor-logger", "Accelerometer.csv"),
    phone_folder("phyphox", "Gyroscope.csv"),
    Target(
        name="sensor-logger-metadata", file="Metadata.csv", form="text",
        beside=phone_folder("sensor-logger", "Metadata.csv").beside, read=gnomon.read,
        seeds=lambda: [phone("sensor-logger")["Metadata.csv"]],
    ),
    Target(name="gpmf-mp4", file="GX01.MP4", seeds=_mp4, read=lambda folder: gnomon.read(folder / "GX01.MP4")),
    Target(
        name="px4-ulog", file="log.ulg", seeds=lambda: _autopilot(field_logs.ulog),
        read=lambda folder: gnomon.read(folder / "log.ulg"),
    ),
    Target(
        name="ardupilot-dataflash", file="log.bin", seeds=lambda: _autopilot(field_logs.dataflash),
        read=lambda folder: gnomon.read(folder / "log.bin"),
    ),
    Target(name="gpmf-raw", file="track.bin", seeds=_raw_gpmf, read=lambda folder: gnomon.read(folder / "track.bin")),
)  # fmt: skip
