"""gnomon noise: from a recording to files that camera-imu takes; whatever is wrong is said in words."""

import json

import numpy as np
import pytest

import gnomon
from gnomon.formats.kalibr.imu import read_imu_input
from gnomon.formats.own.noise_file import load_noise

FILES = ["allan.csv", "imu.yaml", "noise.yaml", "report.html"]
RATE_HZ = 50.0


@pytest.fixture(scope="module")
def simulated(tmp_path_factory, run):
    """A recording of half an hour as `gnomon simulate-noise` makes it."""
    path = tmp_path_factory.mktemp("noise") / "rest.npz"
    options = ("--duration-s", 1800, "--rate-hz", RATE_HZ, "--gyroscope-random-walk", 3e-5, "--seed", 5)
    code, out, _ = run("simulate", "noise", "-o", path, *options)
    assert code == 0
    assert "rest.npz" in out
    return path


@pytest.fixture(scope="module")
def table(simulated):
    """The same as a table t ax ay az gx gy gz, (n, 7)."""
    with np.load(simulated) as arrays:
        values = np.column_stack([arrays["accelerometer"], arrays["gyroscope"]]).astype(float)
    return np.column_stack([np.arange(len(values)) / RATE_HZ, values])


def write_npz(path, table, **more):
    arrays = {
        "t_ns": np.rint(table[:, 0] * 1e9).astype(np.int64),
        "accelerometer": table[:, 1:4],
        "gyroscope": table[:, 4:],
    }
    np.savez(path, **arrays, unit_accelerometer="m/s^2", unit_gyroscope="rad/s", **more)
    return path


@pytest.mark.main
def test_the_whole_way(simulated, run, names):
    code, out, _ = run("noise", simulated)
    folder = simulated.with_name("rest-noise")
    assert code == 0
    assert names(folder) == FILES
    noise = load_noise(folder / "noise.yaml")
    assert noise.accelerometer.rate_hz == pytest.approx(RATE_HZ)
    for sensor, density in {"accelerometer": 2e-3, "gyroscope": 2e-4}.items():
        for axis in noise.triads[sensor].axes:
            assert abs(axis.white_noise.value - density) < 4 * axis.white_noise.sigma
    assert noise.gyroscope.random_walk == pytest.approx(3e-5, rel=0.4)
    known = read_imu_input(folder / "imu.yaml")["imu0"]
    assert known.noise == noise.imu_noise()
    assert known.update_rate_hz == pytest.approx(RATE_HZ)
    assert out.splitlines()[0].startswith("detected: accelerometer in m/s^2")
    assert "10^-3 m/s^2/sqrt(Hz)" in out
    assert max(map(len, out.splitlines()[:-5])) <= 82
    assert str(folder / "report.html") in out


def test_one_document_for_programs(simulated, run, tmp_path, names):
    code, out, _ = run("noise", simulated, "-o", tmp_path / "o", "--json", "--no-report", "--topic", "/a/b")
    document = json.loads(out)
    assert code == document["exit_code"] == 0
    assert set(document["files"]) == {"noise", "imu", "allan"}
    assert document["noise"]["gyroscope"]["units"]["white_noise"] == "rad/s/sqrt(Hz)"
    assert names(tmp_path / "o") == ["allan.csv", "imu.yaml", "noise.yaml"]
    assert "rostopic: /a/b" in (tmp_path / "o" / "imu.yaml").read_text()


def test_files_of_any_kind_give_the_same(table, simulated, run, tmp_path, write_table):
    short = table[:20_000]
    write_table(tmp_path / "t.csv", short)
    write_npz(tmp_path / "n.npz", short)
    results = []
    for name in ("t.csv", "n.npz"):
        code, _, err = run("noise", tmp_path / name, "--no-report")
        assert code == 0, err
        results.append(load_noise(tmp_path / f"{name[0]}-noise" / "noise.yaml"))
    for one, other in zip(results[0].gyroscope.axes, results[1].gyroscope.axes, strict=True):
        assert one.white_noise.value == pytest.approx(other.white_noise.value, rel=1e-6)
    memory = gnomon.Recording.from_arrays(short[:, 0], short[:, 4:], short[:, 1:4])
    from gnomon.calibrate.noise import identify_noise

    found = identify_noise(memory).noise
    assert found.gyroscope.noise_density == pytest.approx(results[1].gyroscope.noise_density, rel=1e-9)


def test_what_moved_at_the_start_can_be_left_out(table, run, tmp_path):
    moved = table.copy()
    moved[100:2000, 1:] += np.sin(np.arange(1900) / 5)[:, None]
    path = write_npz(tmp_path / "moved.npz", moved)
    code, _, err = run("noise", path)
    assert code == 3
    assert "was moved" in err or "was shaken" in err
    assert "--start-s" in err
    code, _, err = run("noise", path, "--start-s", 50, "--stop-s", 1700)
    assert code == 0, err
    noise = load_noise(tmp_path / "moved-noise" / "noise.yaml")
    assert noise.accelerometer.duration_s == pytest.approx(1650, abs=0.1)
    assert noise.provenance.options == {"start_s": "50.0", "stop_s": "1700.0"}


def test_two_accounts_of_one_noise_agree(table, run, tmp_path):
    """The unit does not matter: g and deg/s give what m/s^2 and rad/s do."""
    other = table.copy()
    other[:, 1:4] /= 9.80665
    other[:, 4:] *= 180 / np.pi
    np.savez(tmp_path / "other.npz", accelerometer=other[:, 1:4], gyroscope=other[:, 4:], rate_hz=RATE_HZ)
    write_npz(tmp_path / "si.npz", table)
    for name, more in (("other.npz", ("--units", "g deg/s")), ("si.npz", ())):
        assert run("noise", tmp_path / name, "--no-report", *more)[0] == 0
    found = [load_noise(tmp_path / f"{name}-noise" / "noise.yaml").imu_noise() for name in ("other", "si")]
    assert found[0].gyroscope_noise_density == pytest.approx(found[1].gyroscope_noise_density, rel=1e-6)
    assert found[0].accelerometer_random_walk == pytest.approx(found[1].accelerometer_random_walk, rel=1e-4)


def shaken(table):
    table[40_000:40_200, 1:4] += np.random.default_rng(1).normal(scale=3.0, size=(200, 3))
    return table


def tilted(table):
    table[50_000:, 1] += 0.2
    return table


def turned_slowly(table):
    table[30_000:60_000, 4] += 0.02
    return table


def too_short(table):
    return table[: int(20 * RATE_HZ)]


def backward(table):
    table[4000:, 0] -= 3.0
    return table


def not_a_number(table):
    table[777, 5] = np.nan
    return table


def constant_axis(table):
    table[:, 6] = 0.0
    return table


def all_zero(table):
    table[:, 1:] = 0.0
    return table


def mostly_missing(table):
    return table[np.arange(len(table)) % 3000 < 2000]


def same_stamps(table):
    table[:, 0] = 5.0
    return table


BAD = {
    "shaken": (shaken, "accelerometer was "),
    "tilted": (tilted, "accelerometer was moved, or its bias stepped, at 999 s"),
    "turned": (turned_slowly, "gyroscope was moved"),
    "too short": (too_short, "are too few. At least 60 s"),
    "backward": (backward, "timestamps go backwards at sample 4000"),
    "not a number": (not_a_number, "sample 777 is NaN"),
    "constant axis": (constant_axis, "axis z never changes"),
    "all zero": (all_zero, ""),
    "missing": (mostly_missing, "samples are missing"),
    "same timestamps": (same_stamps, "timestamps are the same"),
}


@pytest.mark.parametrize("name", BAD)
def test_bad_recordings_are_refused_in_words(table, run, tmp_path, name, names):
    change, words = BAD[name]
    path = write_npz(tmp_path / "bad.npz", change(table.copy()))
    code, out, err = run("noise", path)
    assert code == 3, (out, err)
    assert words in err
    assert "Traceback" not in err
    assert names(tmp_path) == ["bad.npz"]


def test_no_stamps_and_no_rate(table, run, tmp_path):
    np.savez(tmp_path / "bare.npz", accelerometer=table[:, 1:4], gyroscope=table[:, 4:])
    code, _, err = run("noise", tmp_path / "bare.npz")
    assert code == 3
    assert "--rate" in err
    assert run("noise", tmp_path / "bare.npz", "--rate", RATE_HZ, "--no-report")[0] == 0


def test_counts_need_a_unit(table, run, tmp_path):
    counts = np.rint(table[:, 1:] * [[1e3] * 3 + [1e5] * 3])
    np.savez(tmp_path / "raw.npz", accelerometer=counts[:, :3], gyroscope=counts[:, 3:], rate_hz=RATE_HZ)
    code, _, err = run("noise", tmp_path / "raw.npz")
    assert code == 3
    assert "raw counts" in err
    assert "gnomon apply" in err


def test_options_that_make_no_sense(simulated, run, tmp_path):
    for options in (("--start-s", -1), ("--start-s", 10, "--stop-s", 5)):
        code, _, err = run("noise", simulated, "-o", tmp_path / "o", *options)
        assert code == 2, err
    code, _, err = run("noise", simulated, "-o", tmp_path / "o", "--start-s", 1e6)
    assert code == 3
    assert "--start-s" in err
    code, _, err = run("simulate", "noise", "-o", tmp_path / "a.csv")
    assert code == 2
    assert ".npz" in err
    assert not (tmp_path / "o").exists()


def test_lost_samples_are_told(table, run, tmp_path):
    keep = np.random.default_rng(2).random(len(table)) > 0.003
    path = write_npz(tmp_path / "gaps.npz", table[keep])
    code, out, err = run("noise", path, "--no-report")
    assert code == 0, err
    assert "samples lost" in out
    noise = load_noise(tmp_path / "gaps-noise" / "noise.yaml")
    assert noise.gyroscope.rate_hz == pytest.approx(RATE_HZ, rel=1e-6)
    assert noise.gyroscope.noise_density == pytest.approx(2e-4, rel=0.01)


def test_an_accelerometer_alone(table, run, tmp_path, names):
    np.savez(tmp_path / "a.npz", accelerometer=table[:, 1:4], rate_hz=RATE_HZ, unit_accelerometer="m/s^2")
    code, _, err = run("noise", tmp_path / "a.npz")
    assert code == 0, err
    assert names(tmp_path / "a-noise") == ["allan.csv", "noise.yaml", "report.html"]


def test_compares_with_a_data_sheet(simulated, run, tmp_path):
    sheet = tmp_path / "mine.yaml"
    sheet.write_text("MINE: {source: made up, gyroscope: {random_walk: 0.6875 deg/sqrt(h)}}", encoding="utf-8")
    code, out, _ = run("noise", simulated, "--datasheet", sheet, "-o", tmp_path / "out", "--json")
    assert code == 0
    (quantity,) = json.loads(out)["datasheet"]["quantities"]
    assert quantity["ratio"] == pytest.approx(1, abs=0.02)
    assert "Against the data sheet" in (tmp_path / "out" / "report.html").read_text(encoding="utf-8")
    assert "deg/sqrt(h)" in (tmp_path / "out" / "noise.yaml").read_text(encoding="utf-8")
    code, _, err = run("noise", simulated, "--bandwidth-hz", 50, "-o", tmp_path / "other")
    assert code == 2
    assert "--datasheet" in err


@pytest.mark.parametrize("kind", ["npz", "csv"])
def test_a_warm_up_that_is_not_over_is_told_with_how_long_to_wait(table, run, tmp_path, kind):
    table = table[: len(table) // 4]
    degc = np.round(40 - 15 * np.exp(-table[:, 0] / 300), 1)
    path = tmp_path / f"warm.{kind}"
    if kind == "npz":
        write_npz(path, table, temperature=degc, unit_temperature=np.array("degC"))
    else:
        header = "t [s],ax [m/s^2],ay [m/s^2],az [m/s^2],gx [rad/s],gy [rad/s],gz [rad/s],temp_degC"
        np.savetxt(path, np.column_stack([table, degc]), delimiter=",", header=header, comments="")
    code, out, err = run("noise", path, "-o", tmp_path / "out", "--no-report")
    assert code in {0, 1, 2, 4}, err
    told = " ".join(out.split())
    assert "by its course" in told
    assert "s longer before recording" in told


@pytest.mark.parametrize("seed", [9021, 77])
def test_rests_of_a_turned_sensor_are_those_that_the_others_find(seed, run, tmp_path):
    """Commands ask one function; their words and counts agree, also where rests are left out."""
    recording, _ = gnomon.simulate(gnomon.Scenario(intervals=24), seed)
    imu = recording.imus["imu0"]
    shaken = imu.accelerometer.values.copy()
    third = slice(int(0.6 * len(shaken)), int(0.75 * len(shaken)))
    shaken[third] += np.random.default_rng(seed).normal(scale=0.6, size=shaken[third].shape)  # a motor runs
    table = np.column_stack([imu.accelerometer.t_s, shaken, imu.gyroscope.values])
    path = write_npz(tmp_path / "turned.npz", table)
    findings = gnomon.check(gnomon.read(path))
    told = {one.code: one.message for one in findings if one.code in ("attitudes", "intervals-left-out")}
    assert len(told) == 2
    code, _, err = run("noise", path)
    assert code == 3
    assert all(one in " ".join(err.split()) for one in told.values())
    found = gnomon.calibrate_imu(gnomon.read(path)).calibration.assessment
    assert f" {found.intervals_found} rests " in told["attitudes"]
    assert f" {found.intervals_used} of them usable" in told["attitudes"]
    assert found.intervals_found > found.intervals_used


def test_the_stretch_to_keep_is_a_rest_and_counted_from_the_start(table, run, tmp_path):
    moved = shaken(table.copy())  # at 800 s
    path = write_npz(tmp_path / "knocked.npz", moved)
    for options in ((), ("--start-s", 200)):
        code, _, err = run("noise", path, *options)
        assert code == 3
        start, stop = (float(err.split(name)[1].split()[0].rstrip(").,")) for name in ("--start-s ", "--stop-s "))
        assert (start, stop) == (pytest.approx(807, abs=4), pytest.approx(1799, abs=2))
        code, _, err = run("noise", path, "--start-s", start, "--stop-s", stop, "--no-report")
        assert code == 0, err


def test_isolated_readings_are_left_out(table, run, tmp_path):
    spoilt = table.copy()
    spoilt[500::2500, 5] = 30.0
    found = []
    for name, values in (("right", table), ("spoilt", spoilt)):
        code, _, err = run("noise", write_npz(tmp_path / f"{name}.npz", values), "--no-report")
        assert code == 0, err
        found.append(load_noise(tmp_path / f"{name}-noise" / "noise.yaml"))
    codes = [{one.code for one in noise.findings} for noise in found]
    assert codes[1] - codes[0] == {"isolated-readings"}
    assert found[1].gyroscope.noise_density == pytest.approx(found[0].gyroscope.noise_density, rel=2e-3)
