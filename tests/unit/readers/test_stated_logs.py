"""Tables that state what their numbers mean are read so."""

import numpy as np
import pytest

import field_devices
from gnomon import read
from gnomon.errors import RecordingError
from gnomon.readers.devices.device_log import is_device_log
from phone_logs import G

# docs.novatel.com/OEM7: the example of each log
PUBLISHED = {
    "%RAWIMUSA,2209,491612.254;2209,491612.253588,ea5afe00,"
    "329303960,-2512321,4410363,309705,607017,-1009773*1fb76c28": (
        (4410363, 2512321, 329303960), (-1009773, -607017, 309705), 491_612_253_588_000,
    ),
    "%RAWIMUSXA,2209,491674.014;04,41,2209,491674.013699,ea59fe00,"
    "329308016,-2706935,4508389,196192,417138,-1000837*038422a7": (
        (4508389, 2706935, 329308016), (-1000837, -417138, 196192), 491_674_013_699_000,
    ),
    "#RAWIMUXA,USB1,0,64.5,FINESTEERING,2209,491740.110,02000020,0dc5,16809;04,41,2209,491740.109817,ea57fe00,"
    "329394068,-2396829,4481425,321199,257329,-936077*cf9c035d": (
        (4481425, 2396829, 329394068), (-936077, -257329, 321199), 491_740_109_817_000,
    ),
}  # fmt: skip


def gcsv(path, *rows, tscale="0.001", gscale="0.00122173047", ascale="0.00048828125"):
    head = f"GYROFLOW IMU LOG\nversion,1.3\nid,a\norientation,YxZ\ntscale,{tscale}\ngscale,{gscale}\nascale,{ascale}\n"
    path.write_text(head + "t,gx,gy,gz,ax,ay,az\n" + "".join(f"{row}\n" for row in rows))
    return path


@pytest.mark.parametrize("line", PUBLISHED, ids=lambda line: line[1:9])
def test_published_lines_of_novatel(line, tmp_path):
    (tmp_path / "imu.txt").write_text(f"{line}\r\n{line[:-1]}0\n{line}\n")
    recording = read(tmp_path / "imu.txt")
    imu = recording.imus["imu0"]
    force, rate, of_week = PUBLISHED[line]
    np.testing.assert_array_equal(imu.accelerometer.values, [force, force])
    np.testing.assert_array_equal(imu.gyroscope.values, [rate, rate])
    assert imu.accelerometer.unit == imu.gyroscope.unit == "count"
    assert imu.accelerometer.t_ns[0] == 2209 * 7 * 86_400 * 10**9 + of_week
    assert any("1 lines with a wrong checksum" in note for note in recording.assumptions)


def test_scales_of_gyroflow(tmp_path):
    rows = ["0,39,86,183,-1137,-15689,-2986", "1,56,100,202,-1179,-15694,-2887"]
    imu = read(gcsv(tmp_path / "video.gcsv", *rows)).imus["imu0"]
    assert (imu.accelerometer.unit, imu.gyroscope.unit) == ("g", "rad/s")
    np.testing.assert_allclose(imu.accelerometer.values[0], np.array([-1137, -15689, -2986]) * 0.00048828125)
    np.testing.assert_allclose(imu.gyroscope.values[1], np.array([56, 100, 202]) * 0.00122173047)
    assert np.diff(imu.accelerometer.t_ns).tolist() == [1_000_000]


@pytest.mark.parametrize(("tscale", "step_ns"), [("1", 1_000_000_000), ("1e-6", 1000), ("0.00025", 250_000)])
def test_gyroflow_counts_time_in_a_unit_of_its_own(tscale, step_ns, tmp_path):
    path = gcsv(tmp_path / "video.gcsv", *(f"{i},1,2,3,4,5,{2000 + i}" for i in range(4)), tscale=tscale)
    assert np.diff(read(path).imus["imu0"].gyroscope.t_ns).tolist() == [step_ns] * 3


@pytest.mark.parametrize("wrong", ["0", "-1", "1e999", "1.2.3"])
def test_a_scale_of_gyroflow_that_is_none(wrong, tmp_path):
    with pytest.raises(RecordingError, match=r"found gscale .*, expected a positive number"):
        read(gcsv(tmp_path / "video.gcsv", "0,1,2,3,4,5,6", "1,1,2,3,4,5,6", gscale=wrong))


def test_wristband(tmp_path):  # support.empatica.com: ACC.csv of an E4
    counts = np.rint(field_devices.A * 64).astype(int)
    rows = "\n".join(",".join(map(str, row)) for row in counts)
    start = "1572606921.000000, 1572606921.000000, 1572606921.000000\n32.000000, 32.000000, 32.000000\n"
    (tmp_path / "ACC.csv").write_text(f"{start}{rows}\n")
    imu = read(tmp_path / "ACC.csv").imus["imu0"]
    np.testing.assert_array_equal(imu.accelerometer.values * 64, counts)
    assert (imu.accelerometer.unit, len(imu.gyroscope)) == ("g", 0)
    assert imu.accelerometer.t_ns[0] == 1_572_606_921 * 10**9
    assert np.diff(imu.accelerometer.t_ns) == pytest.approx(1e9 / 32, abs=1)
    np.testing.assert_allclose(imu.accelerometer.values * G, field_devices.F, atol=0.6 / 64 * G)


@pytest.mark.parametrize("text", ["t,ax,ay,az\n0,1,2,3\n", "1,1,1\n2,2,2\n3,4,5\n", "# RAWIMUSA\n1,2,3\n", "x"])
def test_other_tables_are_left_to_others(text, tmp_path):
    (tmp_path / "log.csv").write_text(text)
    assert not is_device_log((tmp_path / "log.csv",))
