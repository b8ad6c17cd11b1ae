"""Tables of averaged poses, and files of one pose each."""

import numpy as np
import pytest

import gnomon
from gnomon.errors import OptionError, RecordingError
from gnomon.readers.samples.poses import pose_column
from gnomon.recording import Poses
from gnomon.writers.recording_file import save_poses

FACES = np.concatenate([np.eye(3), -np.eye(3)])


@pytest.fixture
def write(tmp_path):
    """Return a function that writes a table with a header."""

    def table(header, rows, name="poses.csv"):
        path = tmp_path / name
        path.write_text("\n".join([header, *(",".join(map(str, row)) for row in rows)]) + "\n")
        return path

    return table


@pytest.mark.parametrize(
    ("text", "kind", "axis", "unit"),
    [
        ("ax [g]", "accelerometer", 0, "g"),
        ("acc_z (m/s^2)", "accelerometer", 2, "m/s^2"),
        ("gyro_y [deg/s]", "gyroscope", 1, "deg/s"),
        ("sigma_ax [g]", "accelerometer_sigma", 0, "g"),
        ("az_std", "accelerometer_sigma", 2, None),
        ("sigma_gy", "gyroscope_sigma", 1, None),
        ("ref_x", "reference", 0, None),
        ("reference_force_y [g]", "reference", 1, "g"),
        ("sz", "reference", 2, None),
        ("samples", "samples", 0, None),
        ("count", "samples", 0, None),
        ("t [ms]", "time", 0, "ms"),
        ("pose", "name", 0, None),
        ("temperature", "", 0, None),
    ],
)
def test_names_of_columns(text, kind, axis, unit):
    column = pose_column(text)
    assert (column.kind, column.axis, column.unit) == (kind, axis, unit)


def test_everything_that_a_table_can_hold(write):
    header = "pose,t [ms],ax [g],ay,az,sigma_ax,sigma_ay,sigma_az,gx [deg/s],gy,gz,samples,ref_x [g],ref_y,ref_z"
    rows = [[f"p{k}", 1000 + 500 * k, *u, *[1e-3] * 3, 0.1, 0.2, 0.3, 50 + k, *u] for k, u in enumerate(FACES)]
    recording = gnomon.read(write(header, rows))
    poses = recording.poses
    assert not recording.imus
    assert poses.name == tuple(f"p{k}" for k in range(6))
    assert (poses.accelerometer_unit, poses.gyroscope_unit) == ("g", "deg/s")
    np.testing.assert_array_equal(poses.accelerometer, FACES)
    np.testing.assert_array_equal(poses.gyroscope, [[0.1, 0.2, 0.3]] * 6)
    np.testing.assert_allclose(poses.accelerometer_sigma, 1e-3)
    assert poses.gyroscope_sigma is None
    np.testing.assert_allclose(poses.t_s, 0.5 * np.arange(6))
    np.testing.assert_array_equal(poses.samples, 50 + np.arange(6))
    np.testing.assert_allclose(poses.specific_force, 9.80665 * FACES)


def test_short_table_without_time_is_taken_for_poses_and_that_is_said(write):
    path = write("ax,ay,az", 9.81 * FACES)
    recording = gnomon.read(path)
    assert recording.poses is not None
    assert any("6 rows are taken for averaged poses" in text for text in recording.assumptions)
    assert recording.poses.accelerometer_unit == "m/s^2"
    assert gnomon.read(path, rate_hz=50).poses is None


def test_samples_stay_samples(write):
    t = 0.01 * np.arange(200)[:, None]
    values = np.random.default_rng(0).normal([0, 0, 9.8], 0.01, (200, 3))
    assert gnomon.read(write("t,ax,ay,az", np.hstack([t, values]), "stream.csv")).poses is None
    many = np.random.default_rng(0).normal([0, 0, 9.8], 0.01, (2000, 3))
    with pytest.raises(RecordingError, match="--rate"):
        gnomon.read(write("ax,ay,az", many, "long.csv"))


def test_columns_can_be_stated(write):
    path = write("p q r s", [[*u, 7] for u in 9.81 * FACES])
    path.write_text(path.read_text().replace(",", " "))
    poses = gnomon.read(path, columns="ax ay az _").poses
    np.testing.assert_allclose(poses.accelerometer, 9.81 * FACES)


def test_a_gyroscope_without_unit_is_guessed_aloud(write):
    rows = [[*(9.81 * u), 0.01, -0.02, 0.005] for u in FACES]
    recording = gnomon.read(write("ax,ay,az,gx,gy,gz", rows))
    assert recording.poses.gyroscope_unit == "rad/s"
    assert any("guessed" in text for text in recording.assumptions)
    assert gnomon.read(write("ax,ay,az,gx,gy,gz", rows), units="m/s^2 deg/s").poses.gyroscope_unit == "deg/s"


@pytest.mark.parametrize(
    ("header", "rows", "message"),
    [
        ("9.81,0,0", 9.81 * FACES, r"name the columns in a header: ax ay az.*ref_x ref_y ref_z"),
        ("ax,ay,az,ref_x,ref_y", np.hstack([FACES, FACES[:, :2]]), "each axis of the reference once"),
        ("ax,ay,az,samples", np.column_stack([FACES, [5, 5, 0, 5, 5, 5]]), r"line 4 \(row 3\).*one sample or more"),
        ("ax,ay,az,sigma_ax,sigma_ay,sigma_az", np.hstack([FACES, 0 * FACES]), "sigma of a mean must be greater"),
        ("ax,ay,az,ref_x,ref_y,ref_z", np.hstack([FACES, 20 * FACES]), "length of 20 m/s.2, expected about 9.81"),
        (
            "ax,ay,az,ref_x,ref_y,ref_z",
            np.hstack([FACES, 9.81 * FACES * np.array([[1, 1, 1, 1, 2, 1]]).T]),
            r"line 6 \(row 5\).*differ in length",
        ),
        ("ax,ay,az", [*FACES[:5].tolist(), ["nan", 0, 1]], "finite number"),
    ],
)
def test_bad_tables_are_named(write, header, rows, message):
    with pytest.raises(RecordingError, match=message) as caught:
        gnomon.read(write(header, rows))
    assert "poses.csv" in str(caught.value)


def pose_file(path, u, *, start=0.0, seed=0, header="t,ax [g],ay,az"):
    rng = np.random.default_rng(seed)
    rows = np.column_stack([start + 0.01 * np.arange(120), u + rng.normal(0, 1e-3, (120, 3))])
    path.write_text(header + "\n" + "\n".join(",".join(f"{x:.6f}" for x in row) for row in rows) + "\n")
    return path


def test_a_folder_of_files_in_the_order_of_their_numbers(tmp_path):
    for k in range(12):
        pose_file(tmp_path / f"pose{k + 1}.csv", FACES[k % 6], seed=k)
    recording = gnomon.read(tmp_path)
    assert [piece.name for piece in recording.pieces] == [f"pose{k + 1}.csv" for k in range(12)]
    assert any("clocks start anew" in text for text in recording.assumptions)
    accelerometer = recording.imus["imu0"].accelerometer
    assert (np.diff(accelerometer.t_ns) > 0).all()
    second = recording.pieces[1]
    np.testing.assert_allclose(accelerometer.values[second.start : second.stop].mean(axis=0), FACES[1], atol=1e-3)
    assert len(recording.sources) == 12


def test_one_clock_orders_the_files(tmp_path):
    paths = [pose_file(tmp_path / f"{k}.csv", FACES[k], start=100.0 - 20 * k, seed=k) for k in range(4)]
    recording = gnomon.read(*paths)
    assert [piece.name for piece in recording.pieces] == ["3.csv", "2.csv", "1.csv", "0.csv"]
    assert recording.imus["imu0"].accelerometer.duration_s == pytest.approx(61.19)


def test_files_that_differ_are_named(tmp_path):
    paths = [pose_file(tmp_path / f"{k}.csv", FACES[k], seed=k) for k in range(3)]
    paths.append(pose_file(tmp_path / "odd.csv", FACES[3], header="t,ax [m/s^2],ay,az"))
    with pytest.raises(RecordingError, match=r"odd.csv: found accelerometer in m/s\^2, but 0.csv holds"):
        gnomon.read(*paths)


def test_two_files_are_still_accelerometer_and_gyroscope(tmp_path):
    paths = [pose_file(tmp_path / f"{k}.csv", FACES[k], seed=k) for k in range(2)]
    with pytest.raises(RecordingError, match="both hold an accelerometer"):
        gnomon.read(*paths)
    with pytest.raises(OptionError, match="0 paths"):
        gnomon.read()


def test_what_is_written_is_read_back(tmp_path):
    rng = np.random.default_rng(1)
    poses = Poses(
        name=tuple(f"pose {k}" for k in range(6)),
        accelerometer=33000 + 5400 * FACES + rng.normal(size=(6, 3)),
        accelerometer_unit="count",
        gyroscope=rng.normal(size=(6, 3)),
        gyroscope_unit="deg/s",
        accelerometer_sigma=rng.uniform(0.1, 1.0, (6, 3)),
        gyroscope_sigma=rng.uniform(0.1, 1.0, (6, 3)),
        samples=rng.integers(10, 100, 6),
        t_s=np.arange(6) * 12.5,
        specific_force=9.81 * FACES,
    )
    save_poses(poses, tmp_path / "poses.csv")
    again = gnomon.read(tmp_path / "poses.csv").poses
    assert (again.name, again.accelerometer_unit, again.gyroscope_unit) == (poses.name, "count", "deg/s")
    for field in ("accelerometer", "gyroscope", "accelerometer_sigma", "gyroscope_sigma", "samples", "t_s"):
        np.testing.assert_array_equal(getattr(again, field), getattr(poses, field))
    np.testing.assert_array_equal(again.specific_force, poses.specific_force)
