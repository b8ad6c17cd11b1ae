"""`gnomon apply` with any of accelerometer, gyroscope and magnetometer, calibrated and recorded."""

import tracemalloc
from dataclasses import replace
from functools import partial

import numpy as np
import pytest

import gnomon
from gnomon.errors import FormatError, RecordingError
from gnomon.readers.samples import stream_text
from gnomon.readers.samples.stream import open_stream, stream_of
from gnomon.results.calibration import interpolate_triad
from gnomon.writers import apply
from gnomon.writers.apply import apply_files, write_calibrated
from triad_subsets import SUBSETS, TRIADS, recorded, subset_calibration

LETTERS = {"accelerometer": "a", "gyroscope": "w", "magnetometer": "m"}
UNITS = {"accelerometer": "m/s^2", "gyroscope": "rad/s", "magnetometer": "uT"}


def imu_of(triads, **changes):
    return subset_calibration(triads, field_unit="uT", **changes).imus["imu0"]


def table(path):
    lines = path.read_text().splitlines()
    rows = [line.split(",") for line in lines[1:]]
    return np.array([int(row[0]) for row in rows]), np.array([[float(x) for x in row[1:]] for row in rows]), lines[0]


def expected(imu, samples, triads):
    """Header, timestamps and values as `apply` in memory gives them, brought to the timestamps of the rows."""
    order = [name for name in ("gyroscope", "accelerometer", "magnetometer") if name in triads]
    done = imu.apply(samples)
    rows = getattr(samples, order[0])
    values = [interpolate_triad(getattr(done, name), rows) for name in order]
    names = [f"{LETTERS[name]}{axis} [{UNITS[name]}]" for name in order for axis in "xyz"]
    return rows.t_ns, np.column_stack(values), ",".join(["t_ns", *names])


def same(path, wanted):
    for found, right in zip(table(path), wanted, strict=True):
        assert np.array_equal(found, right)


def write_csv(path, samples, triads):
    columns = [getattr(samples, name).values for name in triads]
    names = [f"{prefix}{axis}" for name in triads for prefix in [dict(LETTERS, gyroscope="g")[name]] for axis in "xyz"]
    with path.open("w") as file:
        file.write(",".join(["t [ns]", *names]) + "\n")
        for t, row in zip(getattr(samples, triads[0]).t_ns, np.hstack(columns).astype(int), strict=True):
            file.write(",".join(map(str, [t, *row])) + "\n")
    return path


@pytest.mark.parametrize("own_stamps", [False, True])
@pytest.mark.parametrize("triads", SUBSETS)
def test_every_subset_in_memory(tmp_path, triads, own_stamps):
    samples = recorded(triads, own_stamps=own_stamps)
    imu = imu_of(triads, g_sensitivity="accelerometer" in triads)
    wanted = expected(imu, samples, triads)
    for block in (1, 7, 5000):
        write_calibrated(imu, stream_of(samples, block), tmp_path / "out.csv")
        same(tmp_path / "out.csv", wanted)
    assert write_calibrated(imu, stream_of(samples), tmp_path / "out.csv") == len(wanted[0])
    same(tmp_path / "out.csv", wanted)


@pytest.mark.parametrize("kept", SUBSETS)
def test_of_a_recording_with_all_triads_those_are_written_that_were_calibrated(tmp_path, kept):
    samples = recorded(TRIADS, count=80)
    imu = imu_of(kept, g_sensitivity="accelerometer" in kept)
    path = write_csv(tmp_path / "r.csv", samples, TRIADS)
    assert apply_files(imu, path, output=tmp_path / "out.csv") == 80
    same(tmp_path / "out.csv", expected(imu, samples, kept))


@pytest.mark.parametrize("kept", SUBSETS)
def test_of_a_full_calibration_those_are_written_that_were_recorded(tmp_path, kept):
    samples = recorded(kept, count=80)
    imu = imu_of(TRIADS, g_sensitivity="accelerometer" in kept)
    path = write_csv(tmp_path / "r.csv", samples, kept)
    assert apply_files(imu, path, output=tmp_path / "out.csv") == 80
    same(tmp_path / "out.csv", expected(imu, samples, kept))


@pytest.mark.parametrize("triads", SUBSETS)
def test_npz_of_every_subset(tmp_path, triads):
    samples = recorded(triads, own_stamps=True)
    imu = imu_of(triads, g_sensitivity="accelerometer" in triads)
    arrays = {name: getattr(samples, name).values for name in triads}
    stamps = {f"t_{name}_ns": getattr(samples, name).t_ns for name in triads}
    np.savez(tmp_path / "r.npz", **arrays, **stamps)
    apply_files(imu, tmp_path / "r.npz", output=tmp_path / "out.csv")
    same(tmp_path / "out.csv", expected(imu, samples, triads))


def test_npz_of_somebody_else(tmp_path):
    """Arrays named after their sensor, with timestamps in seconds."""
    samples = recorded(("magnetometer",), own_stamps=True)
    t_s = (samples.magnetometer.t_ns - samples.magnetometer.t_ns[0]) * 1e-9
    np.savez(tmp_path / "r.npz", mag=samples.magnetometer.values, t_mag=t_s)
    imu = imu_of(("magnetometer",))
    apply_files(imu, tmp_path / "r.npz", output=tmp_path / "out.csv")
    stamps, values, _ = table(tmp_path / "out.csv")
    assert np.array_equal(values, imu.magnetometer.magnetic_field(samples.magnetometer.values))
    np.testing.assert_allclose(np.diff(stamps), 40_000_000, atol=1)


def test_two_files_of_different_triads(tmp_path):
    samples = recorded(("gyroscope", "magnetometer"), own_stamps=True)
    imu = imu_of(("gyroscope", "magnetometer"), g_sensitivity=False)
    paths = [write_csv(tmp_path / f"{name}.csv", samples, (name,)) for name in ("magnetometer", "gyroscope")]
    apply_files(imu, *paths, output=tmp_path / "out.csv")
    same(tmp_path / "out.csv", expected(imu, samples, ("gyroscope", "magnetometer")))


def test_result_reads_back(tmp_path):
    samples = recorded(TRIADS, count=50)
    imu = imu_of(TRIADS)
    apply_files(imu, write_csv(tmp_path / "r.csv", samples, TRIADS), output=tmp_path / "out.csv")
    back = gnomon.read(tmp_path / "out.csv").imus["imu0"]
    assert [getattr(back, name).unit for name in TRIADS] == [UNITS[name] for name in TRIADS]
    assert np.array_equal(back.magnetometer.values, imu.apply(samples).magnetometer.values)


def test_a_field_without_a_stated_strength_says_its_unit(tmp_path):
    imu = subset_calibration(("magnetometer",)).imus["imu0"]
    write_calibrated(imu, stream_of(recorded(("magnetometer",))), tmp_path / "out.csv")
    assert table(tmp_path / "out.csv")[2] == "t_ns,mx [local field],my [local field],mz [local field]"


def test_g_sensitivity_without_a_force_is_refused(tmp_path):
    samples = recorded(("gyroscope", "magnetometer"))
    path = write_csv(tmp_path / "r.csv", samples, ("gyroscope", "magnetometer"))
    with pytest.raises(FormatError, match=r"g-sensitivity needs .* this calibration holds no accelerometer"):
        apply_files(imu_of(("gyroscope",)), path, output=tmp_path / "out.csv")
    with pytest.raises(FormatError, match=r"g-sensitivity needs .* this recording holds no accelerometer"):
        apply_files(imu_of(TRIADS), path, output=tmp_path / "out.csv")
    with pytest.raises(RecordingError, match=r"this calibration is of accelerometer, and the recording holds none"):
        apply_files(imu_of(("accelerometer",)), path, output=tmp_path / "out.csv")
    assert not (tmp_path / "out.csv").exists()


def test_samples_in_another_unit_are_refused(tmp_path):
    imu = imu_of(("magnetometer",), units=("count", "count", "uT"))
    samples = recorded(("magnetometer",))
    with pytest.raises(FormatError, match="the calibration is for measurements in uT, the samples are in count"):
        write_calibrated(imu, stream_of(samples), tmp_path / "out.csv")
    path = write_csv(tmp_path / "r.csv", samples, ("magnetometer",))
    path.write_text(path.read_text().replace("mx,my,mz", "mx [gauss],my [gauss],mz [gauss]"))
    with pytest.raises(FormatError, match="in uT, the samples are in gauss"):
        apply_files(imu, path, output=tmp_path / "out.csv")


def test_memory_does_not_grow_where_one_triad_of_three_is_calibrated(tmp_path, monkeypatch):
    """What nobody takes is not kept either."""
    monkeypatch.setattr(stream_text, "_RECOGNISED_BYTES", 50_000)
    monkeypatch.setattr(apply, "open_stream", partial(open_stream, block_bytes=50_000))
    imu = imu_of(("magnetometer",))
    peaks = []
    for count in (10_000, 60_000):
        samples = recorded(TRIADS, count=count)
        path = write_csv(tmp_path / f"{count}.csv", samples, TRIADS)
        del samples
        tracemalloc.start()
        assert apply_files(imu, path, output=tmp_path / "out.csv") == count
        peaks.append(tracemalloc.get_traced_memory()[1])
        tracemalloc.stop()
    assert peaks[1] < 1.2 * peaks[0]


def test_stamps_of_a_magnetometer_that_go_backwards(tmp_path):
    samples = recorded(("gyroscope", "magnetometer"), own_stamps=True)
    t_ns = samples.magnetometer.t_ns.copy()
    t_ns[[5, 6]] = t_ns[[6, 5]]
    samples = replace(samples, magnetometer=replace(samples.magnetometer, t_ns=t_ns))
    with pytest.raises(RecordingError, match="the magnetometer's timestamps go backwards"):
        write_calibrated(
            imu_of(("gyroscope", "magnetometer"), g_sensitivity=False), stream_of(samples), tmp_path / "out.csv"
        )
