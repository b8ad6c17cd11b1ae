"""`gnomon apply`: from file to file in blocks, bit by bit what `ImuCalibration.apply` gives in memory."""

import gzip
import tracemalloc
from dataclasses import replace

import numpy as np
import pytest

import gnomon
from gnomon.errors import FormatError, OutputError, RecordingError
from gnomon.readers.samples import stream_text
from gnomon.readers.samples.stream import open_stream, stream_of
from gnomon.recording import ImuSamples, Recording, TemperatureSamples, TriadSamples
from gnomon.results.calibration import interpolate_triad
from gnomon.results.temperature_dependence import TemperatureDependence
from gnomon.units import Units
from gnomon.writers import apply as module
from gnomon.writers.apply import apply_files, write_calibrated
from gnomon.writers.recording_file import save_recording

COUNTS = Units(accelerometer="count", gyroscope="count")


def samples(count=1000, seed=0, *, own_stamps=False, start_ns=1_600_000_000_000_000_000):
    rng = np.random.default_rng(seed)
    t = start_ns + np.cumsum(rng.integers(9_000_000, 11_000_000, count))
    t_gyro = start_ns + 4_000_000 + np.cumsum(rng.integers(4_000_000, 6_000_000, 2 * count)) if own_stamps else t
    return ImuSamples(
        accelerometer=TriadSamples(t_ns=t, values=np.rint(rng.normal(33000, 4000, (count, 3))), unit="count"),
        gyroscope=TriadSamples(t_ns=t_gyro, values=np.rint(rng.normal(32000, 9000, (len(t_gyro), 3))), unit="count"),
    )


def expected(imu, recorded):
    """Timestamps, rate and force in one table, from `apply` in memory."""
    done = imu.apply(recorded)
    force = interpolate_triad(done.accelerometer, recorded.gyroscope)
    return np.column_stack([done.gyroscope.values, force]), recorded.gyroscope.t_ns


def table(path):
    lines = path.read_text().splitlines()
    stamps = np.array([int(line.split(",")[0]) for line in lines[1:]])
    return np.array([[float(x) for x in line.split(",")[1:]] for line in lines[1:]]), stamps, lines[0]


def same(path, wanted):
    values, stamps, header = table(path)
    assert np.array_equal(stamps, wanted[1])
    assert np.array_equal(values, wanted[0])
    assert header == "t_ns,wx [rad/s],wy [rad/s],wz [rad/s],ax [m/s^2],ay [m/s^2],az [m/s^2]"


def write_csv(path, recorded, *, opener=open):
    t, a, w = recorded.accelerometer.t_ns, recorded.accelerometer.values, recorded.gyroscope.values
    with opener(path, "wt") as file:
        file.write("# a comment\ntimestamp [ns],wx,wy,wz,ax,ay,az\n")
        for row in zip(t, *w.T, *a.T, strict=True):
            file.write(",".join(str(int(x)) for x in row) + "\n")
    return path


@pytest.mark.parametrize("block", [1, 7, 64, 5000])
@pytest.mark.parametrize("own_stamps", [False, True])
def test_blocks_of_any_length_give_the_same_bits(random_calibration, tmp_path, block, own_stamps):
    imu = random_calibration(21).imus["imu0"]
    recorded = samples(300, own_stamps=own_stamps)
    write_calibrated(imu, stream_of(recorded, block), tmp_path / "out.csv")
    same(tmp_path / "out.csv", expected(imu, recorded))


def test_stamps_that_part_company_on_the_way(random_calibration, tmp_path):
    imu = random_calibration(22).imus["imu0"]
    recorded = samples(200)
    t = recorded.gyroscope.t_ns.copy()
    t[120:] += 3_000_000
    gyroscope = TriadSamples(t_ns=t, values=recorded.gyroscope.values, unit="count")
    recorded = ImuSamples(accelerometer=recorded.accelerometer, gyroscope=gyroscope)
    for block in (1, 40, 50, 1000):
        write_calibrated(imu, stream_of(recorded, block), tmp_path / "out.csv")
        same(tmp_path / "out.csv", expected(imu, recorded))


@pytest.mark.parametrize("block_bytes", [200, 1000, 1 << 20])
@pytest.mark.parametrize("opener", [open, gzip.open])
def test_text_file(random_calibration, tmp_path, block_bytes, opener):
    imu = random_calibration(23).imus["imu0"]
    path = write_csv(tmp_path / "r.csv", samples(200), opener=opener)
    stream = open_stream(path, expected=COUNTS, block_bytes=block_bytes)
    write_calibrated(imu, stream, tmp_path / "out.csv")
    same(tmp_path / "out.csv", expected(imu, gnomon.read(path).imus["imu0"]))


def test_pair_of_tables_with_stamps_in_seconds(random_calibration, tmp_path):
    imu = random_calibration(24).imus["imu0"]
    rng = np.random.default_rng(0)
    folder = tmp_path / "r"
    folder.mkdir()
    for name, rate in (("acc", 50), ("gyro", 100)):
        t = np.arange(6 * rate) / rate + 0.0123
        np.savetxt(folder / f"{name}.txt", np.column_stack([t, rng.integers(0, 65536, (len(t), 3))]), fmt="%.4f")
    recorded = gnomon.read(folder).imus["imu0"]
    for block_bytes in (100, 3000, 1 << 20):
        stream = open_stream(folder, expected=COUNTS, block_bytes=block_bytes)
        write_calibrated(imu, stream, tmp_path / "out.csv")
        same(tmp_path / "out.csv", expected(imu, recorded))


@pytest.mark.parametrize("content", ["no timestamps", "late fractions", "columns", "utf-16", "epoch seconds"])
def test_what_the_reader_knows_the_stream_knows(random_calibration, tmp_path, content):
    imu = random_calibration(25).imus["imu0"]
    path, options = tmp_path / "r.txt", {}
    numbers = np.random.default_rng(1).integers(0, 65536, (400, 6)).tolist()
    stamps = [f"{10 * i}" for i in range(400)]
    if content == "late fractions":  # whole numbers at first
        stamps[300:] = [f"{10 * i}.5" for i in range(300, 400)]
    if content == "epoch seconds":
        stamps = [f"{1_600_000_000 + i // 100}.{i % 100:02d}0000001" for i in range(400)]
    rows = [[stamp, *map(str, row)] for stamp, row in zip(stamps, numbers, strict=True)]
    header = "t,ax,ay,az,gx,gy,gz\n"
    if content == "no timestamps":
        rows, header, options = [row[1:] for row in rows], "ax,ay,az,gx,gy,gz\n", {"rate_hz": 123.0}
    if content == "columns":
        header, options = "", {"columns": "t gx gy gz ax ay az"}
    encoding = "utf-16" if content == "utf-16" else "utf-8"
    path.write_text(header + "".join(",".join(row) + "\n" for row in rows), encoding=encoding)
    recorded = gnomon.read(path, **options).imus["imu0"]
    for block_bytes in (333, 1 << 20):
        stream = open_stream(path, expected=COUNTS, block_bytes=block_bytes, **options)
        write_calibrated(imu, stream, tmp_path / "out.csv")
        same(tmp_path / "out.csv", expected(imu, recorded))


def test_cut_last_line_is_left_out_as_by_the_reader(random_calibration, tmp_path):
    imu = random_calibration(26).imus["imu0"]
    path = write_csv(tmp_path / "r.csv", samples(200))
    data = path.read_bytes()
    path.write_bytes(data[:-20])
    recorded = gnomon.read(path).imus["imu0"]
    assert len(recorded.accelerometer) == 199
    for block_bytes in range(300, 420, 17):
        write_calibrated(imu, open_stream(path, expected=COUNTS, block_bytes=block_bytes), tmp_path / "out.csv")
        assert len(table(tmp_path / "out.csv")[1]) == 199


@pytest.mark.parametrize("saver", [np.savez, np.savez_compressed])
@pytest.mark.parametrize("order", ["C", "F"])
def test_npz(random_calibration, tmp_path, saver, order):
    imu = random_calibration(27).imus["imu0"]
    recorded = samples(500, own_stamps=True)
    saver(
        tmp_path / "r.npz",
        accelerometer=np.asarray(recorded.accelerometer.values, order=order).astype(np.int32),
        gyroscope=np.asarray(recorded.gyroscope.values, order=order),
        t_accelerometer_ns=recorded.accelerometer.t_ns,
        t_gyroscope_ns=recorded.gyroscope.t_ns,
    )
    read = gnomon.read(tmp_path / "r.npz").imus["imu0"]
    for block_bytes in (24, 1000, 1 << 20):
        stream = open_stream(tmp_path / "r.npz", expected=COUNTS, block_bytes=block_bytes)
        write_calibrated(imu, stream, tmp_path / "out.csv")
        same(tmp_path / "out.csv", expected(imu, read))


@pytest.mark.parametrize(
    "clock", [{"t_s": np.arange(100) * 0.01}, {"rate_hz": 200.0}, {"t_accelerometer_s": np.arange(100) * 0.1}]
)
def test_npz_clocks(random_calibration, tmp_path, clock):
    imu = random_calibration(28).imus["imu0"]
    recorded = samples(100)
    arrays = {"imu1.accelerometer": recorded.accelerometer.values, "imu1.gyroscope": recorded.gyroscope.values}
    clock = {f"imu1.{key}": value for key, value in clock.items()}
    np.savez(tmp_path / "r.npz", **arrays, **clock)
    read = gnomon.read(tmp_path / "r.npz").imus["imu1"]
    stream = open_stream(tmp_path / "r.npz", expected=COUNTS, imu="imu1", block_bytes=500)
    write_calibrated(imu, stream, tmp_path / "out.csv")
    same(tmp_path / "out.csv", expected(imu, read))


def test_recording_in_memory_and_result_reads_back(random_calibration, tmp_path):
    imu = random_calibration(29).imus["imu0"]
    recorded = samples(300)
    path = write_csv(tmp_path / "r.csv", recorded)
    assert apply_files(imu, path, output=tmp_path / "a.csv") == 300
    back = gnomon.read(tmp_path / "a.csv").imus["imu0"]
    assert (back.accelerometer.unit, back.gyroscope.unit) == ("m/s^2", "rad/s")
    assert np.array_equal(back.accelerometer.values, imu.apply(recorded).accelerometer.values)


def test_without_gyroscope(random_calibration, tmp_path):
    """Where calibration or recording have no gyroscope, the table holds specific force alone."""
    recorded = samples(50)
    force = random_calibration(30).imus["imu0"].accelerometer.specific_force(recorded.accelerometer.values)
    path = write_csv(tmp_path / "r.csv", recorded)
    apply_files(random_calibration(30, gyroscope=False).imus["imu0"], path, output=tmp_path / "a.csv")
    np.savez(tmp_path / "r.npz", accelerometer=recorded.accelerometer.values, t_ns=recorded.accelerometer.t_ns)
    apply_files(random_calibration(30).imus["imu0"], tmp_path / "r.npz", output=tmp_path / "b.csv")
    for name in ("a.csv", "b.csv"):
        values, _, header = table(tmp_path / name)
        assert header == "t_ns,ax [m/s^2],ay [m/s^2],az [m/s^2]"
        assert np.array_equal(values, force)


def test_memory_does_not_grow(random_calibration, tmp_path):
    imu = random_calibration(31).imus["imu0"]
    peaks = []
    for count in (40_000, 320_000):
        recorded = samples(count)
        np.savez(
            tmp_path / "r.npz",
            accelerometer=recorded.accelerometer.values,
            gyroscope=recorded.gyroscope.values,
            t_ns=recorded.accelerometer.t_ns,
            unit_accelerometer="count",
        )
        del recorded
        blocks = module.calibrated_blocks(imu, open_stream(tmp_path / "r.npz", expected=COUNTS, block_bytes=100_000))
        tracemalloc.start()
        rows = sum(len(t_ns) for t_ns, _ in blocks)
        peaks.append(tracemalloc.get_traced_memory()[1])
        tracemalloc.stop()
        assert rows == count
    assert peaks[1] < 1.2 * peaks[0]


def test_memory_does_not_grow_with_text(random_calibration, tmp_path, monkeypatch):
    monkeypatch.setattr(stream_text, "_RECOGNISED_BYTES", 50_000)
    imu = random_calibration(31).imus["imu0"]
    peaks = []
    for count in (10_000, 60_000):
        path = tmp_path / "r.csv"
        rows = "".join(f"{10_000_000 * i},1,2,3,4,5,6\n" for i in range(count))
        path.write_text("t_ns,ax,ay,az,gx,gy,gz\n" + rows)
        blocks = module.calibrated_blocks(imu, open_stream(path, expected=COUNTS, block_bytes=50_000))
        tracemalloc.start()
        assert sum(len(t_ns) for t_ns, _ in blocks) == count
        peaks.append(tracemalloc.get_traced_memory()[1])
        tracemalloc.stop()
    assert peaks[1] < 1.2 * peaks[0]


def test_other_units_are_refused(random_calibration, tmp_path):
    imu = random_calibration(32).imus["imu0"]
    header = tmp_path / "h.csv"
    names = "t [s],ax [m/s^2],ay [m/s^2],az [m/s^2],gx [rad/s],gy [rad/s],gz [rad/s]"
    header.write_text(f"{names}\n1,2,3,4,5,6,7\n2,3,4,5,6,7,8\n")
    still = tmp_path / "s.csv"
    still.write_text("t,ax,ay,az,gx,gy,gz\n" + "".join(f"{i / 100},0.1,0.2,9.8,0.01,0.02,0.03\n" for i in range(200)))
    for path in (header, still):
        with pytest.raises(FormatError, match=r"is for measurements in count, the samples are in (m/s\^2|rad/s)\."):
            apply_files(imu, path, output=tmp_path / "out.csv")
    assert not (tmp_path / "out.csv").exists()
    apply_files(imu, still, output=tmp_path / "out.csv", units=COUNTS)
    assert (tmp_path / "out.csv").exists()


def test_trouble_on_the_way_leaves_nothing(random_calibration, tmp_path):
    imu = random_calibration(33).imus["imu0"]
    path = write_csv(tmp_path / "r.csv", samples(300))
    lines = path.read_text().splitlines()
    lines[250] = lines[250].replace(",", ",oops,", 1)
    path.write_text("\n".join(lines) + "\n")
    with pytest.raises(RecordingError, match=r"r\.csv, line 251"):
        write_calibrated(imu, open_stream(path, expected=COUNTS, block_bytes=2000), tmp_path / "out.csv")
    assert [path.name for path in tmp_path.iterdir()] == ["r.csv"]


def test_line_numbers_count_from_the_top_of_the_file(random_calibration, tmp_path, monkeypatch):
    """An error far behind the beginning, which only the stream sees, names the line of the file."""
    monkeypatch.setattr(stream_text, "_RECOGNISED_BYTES", 4000)
    path = write_csv(tmp_path / "r.csv", samples(2000))
    lines = path.read_text().splitlines()
    lines[1500] = lines[1500].rpartition(",")[0] + ",x"
    path.write_text("\n".join(lines) + "\n")
    with pytest.raises(RecordingError, match=r'r\.csv, line 1501, column 7 .*found "x"'):
        apply_files(random_calibration(33).imus["imu0"], path, output=tmp_path / "out.csv")


def test_cut_gzip(random_calibration, tmp_path):
    path = write_csv(tmp_path / "r.csv.gz", samples(3000), opener=gzip.open)
    path.write_bytes(path.read_bytes()[:-500])
    with pytest.raises(RecordingError, match="cut off"):
        apply_files(random_calibration(34).imus["imu0"], path, output=tmp_path / "out.csv")


def test_backward_stamps_cannot_be_interpolated(random_calibration, tmp_path):
    recorded = samples(100, own_stamps=True)
    for swapped in ("accelerometer", "gyroscope"):
        t = getattr(recorded, swapped).t_ns.copy()
        t[[30, 40]] = t[[40, 30]]
        triads = {"accelerometer": recorded.accelerometer, "gyroscope": recorded.gyroscope}
        triads[swapped] = TriadSamples(t_ns=t, values=triads[swapped].values, unit="count")
        with pytest.raises(RecordingError, match=f"{swapped}'s timestamps go backwards"):
            write_calibrated(
                random_calibration(35).imus["imu0"], stream_of(ImuSamples(**triads), 10), tmp_path / "out.csv"
            )


def test_unwritable_output(random_calibration, tmp_path):
    path = write_csv(tmp_path / "r.csv", samples(10))
    with pytest.raises(OutputError, match="cannot be written"):
        apply_files(random_calibration().imus["imu0"], path, output=tmp_path / "none" / "out.csv")


def test_xsens_file_to_file(real_data, random_calibration, tmp_path):
    imu = random_calibration(36).imus["imu0"]
    folder = real_data("xsens_mti")
    assert apply_files(imu, folder, output=tmp_path / "out.csv") == 51_175
    values, t_ns = expected(imu, gnomon.read(folder).imus["imu0"])
    text = np.loadtxt(tmp_path / "out.csv", delimiter=",", skiprows=1)
    assert np.array_equal(text[:, 1:], values)
    assert np.array_equal(text[:, 0], t_ns)


WARM = TemperatureDependence(
    reference_degc=20.0, low_degc=0.0, high_degc=40.0, lag_s=2.0,
    accelerometer_bias=np.array([[3.0, -2.0, 1.0]]), gyroscope_bias=np.array([[1.0, 2.0, -3.0], [0.1, 0.0, 0.2]]),
)  # fmt: skip


def warming(tmp_path, from_degc, to_degc, *, temperature=True):
    """A file of counts whose chip warms up, and its samples."""
    recorded = samples(300, start_ns=0)
    t_ns = recorded.gyroscope.t_ns
    course = TemperatureSamples(t_ns=t_ns, values=np.linspace(from_degc, to_degc, len(t_ns)), unit="degC")
    recorded = replace(recorded, temperature=course if temperature else None)
    path = tmp_path / "warming.npz"
    save_recording(Recording(imus={"imu0": recorded}), path)
    return path, recorded


def test_files_are_corrected_for_their_temperature_too(tmp_path, random_calibration):
    imu = replace(random_calibration(40).imus["imu0"], temperature=WARM)
    path, recorded = warming(tmp_path, 5.0, 35.0)
    apply_files(imu, path, output=tmp_path / "out.csv")
    same(tmp_path / "out.csv", expected(imu, recorded))


def test_files_without_a_temperature_are_refused_where_it_matters(tmp_path, random_calibration):
    imu = replace(random_calibration(41).imus["imu0"], temperature=WARM)
    path, recorded = warming(tmp_path, 5.0, 35.0, temperature=False)
    with pytest.raises(FormatError, match="thermometer"):
        apply_files(imu, path, output=tmp_path / "out.csv")
    apply_files(imu, path, output=tmp_path / "out.csv", temperature_c=30.0)
    stated = TemperatureSamples(t_ns=recorded.gyroscope.t_ns[[0, -1]], values=np.full(2, 30.0), unit="degC")
    same(tmp_path / "out.csv", expected(imu, replace(recorded, temperature=stated)))
    nothing = replace(imu, temperature=TemperatureDependence(reference_degc=20.0, low_degc=0.0, high_degc=40.0))
    apply_files(nothing, path, output=tmp_path / "out.csv")
    same(tmp_path / "out.csv", expected(replace(imu, temperature=None), recorded))
    assert nothing.apply(recorded).gyroscope.unit == "rad/s"


def test_a_temperature_beyond_the_range_is_said_or_refused(tmp_path, random_calibration):
    imu = replace(random_calibration(42).imus["imu0"], temperature=WARM)
    path, recorded = warming(tmp_path, 20.0, 60.0)
    with pytest.warns(UserWarning, match="beyond the range"):
        apply_files(imu, path, output=tmp_path / "out.csv")
    same(tmp_path / "out.csv", expected(imu, recorded))
    with pytest.raises(RecordingError, match="beyond the range"):
        apply_files(imu, path, output=tmp_path / "strict.csv", strict=True)
    assert not (tmp_path / "strict.csv").exists()
