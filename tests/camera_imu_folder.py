"""A folder with a recording of cameras and an IMU, and what can be wrong with it.

Each function here returns an edit: a function that spoils the folder it is given.
"""

import gzip
import re

import numpy as np

import gnomon


def read_table(path):
    """Return the header, the timestamps (n,) int64, and the other columns (n, c)."""
    with gzip.open(path, "rt", encoding="ascii") as file:
        header, *rows = file.read().splitlines()
    cells = [row.split(",") for row in rows]
    return (
        header,
        np.array([row[0] for row in cells], dtype=np.int64),
        np.array([row[1:] for row in cells], dtype=float),
    )


def write_table(path, header, t_ns, columns):
    rows = (f"{t},{','.join(f'{x:.12g}' for x in row)}" for t, row in zip(t_ns.tolist(), columns.tolist(), strict=True))
    with gzip.open(path, "wt", compresslevel=1, encoding="ascii") as file:
        file.write("\n".join([header, *rows]) + "\n")


def samples(change, header=None):
    """Change the IMU's samples: `change` takes and returns timestamps and (n, 6), accelerometer first."""

    def edit(folder):
        path = folder / "imu0.csv.gz"
        stated, t_ns, values = read_table(path)
        write_table(path, header or stated, *change(t_ns, values))

    return edit


def corners(change, camera="cam0"):
    """Change the corners: `change` takes and returns timestamps, numbers of points (n,) and pixels (n, 2)."""

    def edit(folder):
        path = folder / f"{camera}_corners.csv.gz"
        header, t_ns, columns = read_table(path)
        t_ns, point, pixels = change(t_ns, columns[:, 0].astype(int), columns[:, 1:])
        write_table(path, header, t_ns, np.column_stack([point, pixels]))

    return edit


def scaled(*, accelerometer=1.0, gyroscope=1.0, header=None):
    """Write the samples in other units."""
    factors = np.repeat([accelerometer, gyroscope], 3)
    return samples(lambda t_ns, values: (t_ns, values * factors), header)


def renumbered(number):
    """Give the corners other numbers."""
    return corners(lambda t_ns, point, pixels: (t_ns, number(point), pixels))


def some_frames(choose):
    """Keep the corners of some frames; `choose` takes the timestamps of all."""

    def change(t_ns, point, pixels):
        kept = np.isin(t_ns, choose(np.unique(t_ns)))
        return t_ns[kept], point[kept], pixels[kept]

    return corners(change)


def replaced(file, pattern, text):
    """Replace a text in one of Kalibr's files."""

    def edit(folder):
        before = (folder / file).read_text(encoding="utf-8")
        after = re.sub(pattern, text, before)
        assert after != before
        (folder / file).write_text(after, encoding="utf-8")

    return edit


def emptied(file):
    """Leave a file of no bytes."""

    def edit(folder):
        (folder / file).unlink()
        (folder / file.removesuffix(".gz")).write_bytes(b"")

    return edit


def without(*files):
    def edit(folder):
        for file in files:
            (folder / file).unlink()

    return edit


def altogether(*edits):
    def edit(folder):
        for one in edits:
            one(folder)

    return edit


def stated_extrinsics(turn):
    """State T_cam_imu in camchain.yaml, the true one turned by a rotation (3, 3) of the camera."""

    def edit(folder):
        true = gnomon.load(folder / "truth.yaml").cameras["cam0"].T_cam_imu
        T = np.eye(4)
        T[:3] = turn @ true[:3]
        rows = "".join(f"  - [{', '.join(f'{value:.9f}' for value in row)}]\n" for row in T)
        path = folder / "camchain.yaml"
        path.write_text(path.read_text(encoding="utf-8") + f"  T_cam_imu:\n{rows}", encoding="utf-8")

    return edit
