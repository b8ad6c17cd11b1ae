"""What apps on phones export, made as their documentation describes it."""

import zipfile

import numpy as np

EPOCH_NS = 1_698_501_144_401_773_000
G = 9.80665


def motion(count=2000, step_s=0.01, seed=1):
    """Return time [s], specific force and angular rate, (n, 3) each, of a phone that rests in several attitudes."""
    from gnomon.geometry.rotations import rotation_from_rotvec, rotvec_from_rotation

    rng = np.random.default_rng(seed)
    t = step_s * np.arange(count)
    angle = np.interp(t / t[-1], np.linspace(0, 1, 8), [0, 0, 1.5, 1.5, 3.0, 3.0, 4.5, 4.5])
    R = rotation_from_rotvec(np.outer(angle, [1, 0, 0])) @ rotation_from_rotvec(np.outer(0.7 * angle, [0, 1, 0]))
    turns = rotvec_from_rotation(np.swapaxes(R[:-1], 1, 2) @ R[1:]) / step_s
    force = np.swapaxes(R, 1, 2) @ np.array([0.0, 0.0, G])
    rate = np.vstack([turns, turns[-1]])
    return t, force + rng.normal(0, 0.02, force.shape), rate + rng.normal(0, 0.002, rate.shape)


def table(path, header, rows, *, separator=",", comma=False, encoding="utf-8", number="%.9f"):
    """Write a table; numbers that are text stay as they are."""
    lines = [separator.join(x if isinstance(x, str) else number % x for x in row) for row in rows]
    body = "\n".join(lines).replace(".", ",") if comma else "\n".join(lines)
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_bytes(f"{header}\n{body}\n".encode(encoding))


def zipped(folder, path, prefix=""):
    """Pack a folder."""
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
        for file in sorted(folder.rglob("*")):
            if file.is_file() and file.suffix != ".zip":
                archive.write(file, prefix + file.relative_to(folder).as_posix())
    return path


def sensor_logger(path, t, values, offset_s=0.0):
    """Write a table of Sensor Logger: the columns are z, y, x."""
    stamps = (EPOCH_NS + np.rint((t + offset_s) * 1e9).astype(np.int64)).tolist()
    rows = [(str(ns), f"{s:.9f}", *row[::-1]) for ns, s, row in zip(stamps, t, values, strict=True)]
    table(path, "time,seconds_elapsed,z,y,x", rows)


def metadata(folder, platform, standardised="false"):
    """Write Metadata.csv."""
    names = "version,device name,recording epoch time,recording time,platform,appVersion,standardisation"
    values = f"3,A phone,1698501144400,2023-10-28_13-52-24,{platform},1.29.1,{standardised}"
    (folder / "Metadata.csv").write_text(f"{names}\n{values}\n", encoding="utf-8")


def phyphox(path, what, unit, t, values, *, separator=",", comma=False, encoding="utf-8"):
    """Write a table of phyphox."""
    names = ["Time (s)", *(f"{what} {axis} ({unit})" for axis in "xyz")]
    header = separator.join(f'"{name}"' for name in names)
    rows = zip(t, *np.transpose(values), strict=True)
    table(path, header, rows, separator=separator, comma=comma, encoding=encoding, number="%.9E")
