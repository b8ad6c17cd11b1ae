"""GPMF and MP4 files with telemetry, made as the public documentation of GPMF describes them."""

import struct

import numpy as np

PAYLOAD_S = 1.001
FRAME_US = 85_000


def entry(key, kind, data, size=None, count=None):
    """Return one entry of GPMF; nested where `kind` is None."""
    if kind is None:
        size, count = (1, len(data)) if len(data) < 65536 else (4, len(data) // 4)
    head = key.encode() + (kind or "\0").encode("latin-1") + bytes([size or 1]) + struct.pack(">H", count)
    return head + data + bytes(-len(data) % 4)


def text(key, words):
    data = words.encode("latin-1")
    return entry(key, "c", data, 1, len(data))


def whole(key, number, kind="L"):
    data = struct.pack({"L": ">L", "J": ">Q"}[kind], number)
    return entry(key, kind, data, len(data), 1)


def values(key, rows, kind="f"):
    """Return samples (n, k) as 32-bit floats, or as they are rounded to 16 bits."""
    rows = np.asarray(rows)
    data = rows.astype({"f": ">f4", "s": ">i2"}[kind]).tobytes()
    return entry(key, kind, data, rows.shape[1] * {"f": 4, "s": 2}[kind], len(rows))


def stream(key, rows, *, total=None, stamp_us=None, name="", orientation=None, unit=None, scale=1, kind="f", more=b""):
    """Return a stream of samples that stand in the order of the file."""
    parts = [b"" if stamp_us is None else whole("STMP", stamp_us, "J")]
    parts += [b"" if total is None else whole("TSMP", total), text("STNM", name) if name else b""]
    parts += [text("SIUN", unit) if unit else b"", text("ORIN", orientation) if orientation else b""]
    parts += [entry("SCAL", "s", struct.pack(">h", scale), 2, 1), more, values(key, np.asarray(rows) * scale, kind)]
    return entry("STRM", None, b"".join(parts))


def device(*streams, name="Hero7 Black", identity=1):
    return entry("DEVC", None, whole("DVID", identity) + text("DVNM", name) + b"".join(streams))


def box(kind, *parts):
    data = b"".join(parts)
    return struct.pack(">I", 8 + len(data)) + kind.encode() + data


def _full(kind, *parts):
    return box(kind, bytes(4), *parts)


def with_telemetry(video, payloads, durations_ms):
    """Return the bytes of an MP4, whose index stands at its end, with a track of GPMF added."""
    at, index = 0, None
    while at < len(video):
        size, kind = struct.unpack(">I4s", video[at : at + 8])
        if kind == b"moov":
            index = at
        at += size
    assert index is not None
    assert at == len(video)
    data, moov = video[:index], video[index + 8 :]
    return data + telemetry_tail(len(data), moov, payloads, durations_ms)


def telemetry_only(payloads, durations_ms):
    """Return an MP4 that holds nothing but a track of GPMF."""
    head = box("ftyp", b"mp41", bytes(4), b"mp41")
    mvhd = _full(
        "mvhd", bytes(8), struct.pack(">II", 1000, sum(durations_ms)), bytes(72), struct.pack(">I", 2), bytes(4)
    )
    return head + telemetry_tail(len(head), mvhd, payloads, durations_ms)


def telemetry_tail(offset, moov, payloads, durations_ms):
    places = np.cumsum([offset + 8, *map(len, payloads)])[:-1].tolist()
    count, lasts = len(payloads), sum(durations_ms)
    stbl = box(
        "stbl",
        _full("stsd", struct.pack(">I", 1), box("gpmd", bytes(6), struct.pack(">HI", 1, 0))),
        _full("stts", struct.pack(">I", count), *(struct.pack(">II", 1, ms) for ms in durations_ms)),
        _full("stsc", struct.pack(">IIII", 1, 1, 1, 1)),
        _full("stsz", struct.pack(">II", 0, count), *(struct.pack(">I", len(data)) for data in payloads)),
        _full("stco", struct.pack(">I", count), *(struct.pack(">I", place) for place in places)),
    )
    dinf = box("dinf", _full("dref", struct.pack(">I", 1), box("url ", struct.pack(">I", 1))))
    gmhd = box("gmhd", _full("gmin", bytes(12)), box("gpmd", bytes(4)))
    mdia = box(
        "mdia",
        _full("mdhd", bytes(8), struct.pack(">IIHH", 1000, lasts, 0x55C4, 0)),
        _full("hdlr", b"mhlrmeta", bytes(12), b"\x0bGoPro MET  "),
        box("minf", gmhd, dinf, stbl),
    )
    identity = struct.pack(">9I", 1 << 16, 0, 0, 0, 1 << 16, 0, 0, 0, 1 << 30)
    tkhd = box("tkhd", struct.pack(">I", 7), bytes(8), struct.pack(">III", 9, 0, lasts), bytes(16), identity, bytes(8))
    return box("mdat", *payloads) + box("moov", moov, box("trak", tkhd, mdia))


def payloads_of(
    accelerometer, gyroscope, rate_hz, *, first_us=80_000, stamps=True, jitter=0, seed=0, orientation="ZXY"
):
    """Return payloads that hold samples (n, 3) in x, y, z, and their durations [ms]; each a second, but the last.

    Parameters
    ----------
    rate_hz : of both sensors
    first_us : timestamp of the first sample; the video begins at `FRAME_US`
    stamps : whether they hold timestamps and streams of the video
    jitter : samples by which a payload begins too early or too late at most
    """
    rng = np.random.default_rng(seed)
    count = len(accelerometer)
    ends = np.arange(1, int(np.ceil(count / rate_hz / PAYLOAD_S)) + 1) * PAYLOAD_S * rate_hz
    ends = np.minimum(np.rint(ends).astype(int) + rng.integers(-jitter, jitter + 1, len(ends)), count)
    ends[-1] = count
    found, durations, begin = [], [], 0
    for number, end in enumerate(ends.tolist()):
        stamp = round(first_us + begin / rate_hz * 1e6) if stamps else None
        said = {"total": end, "stamp_us": stamp, "orientation": orientation}
        streams = [
            stream("ACCL", stored(accelerometer[begin:end], orientation), unit="m/s²", **said),
            stream("GYRO", stored(gyroscope[begin:end], orientation), unit="rad/s", **said),
        ]
        if stamps:
            shutter = np.full((30, 1), 0.01)
            streams.append(stream("SHUT", shutter, total=30 * (number + 1), stamp_us=FRAME_US + 1_001_000 * number))
        found.append(device(*streams))
        durations.append(1001 if end < count else max(1, round(1000 * (count / rate_hz - number * PAYLOAD_S))))
        begin = end
    return found, durations


def stored(rows, orientation):
    """Return rows in x, y, z in the order of the file."""
    return np.column_stack([rows[:, "XYZ".index(a.upper())] * (1 if a.isupper() else -1) for a in orientation])
