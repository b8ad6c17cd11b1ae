"""The sketches of examples/devices, compiled for the host, run against sensors that are played by their registers."""

import shutil
import subprocess
from pathlib import Path

import numpy as np
import pytest

from field_logs import samples
from gnomon import read

ROOT = Path(__file__).parents[3]
LIBRARY = ROOT / "examples" / "devices" / "GnomonImu"
RATES_HZ = {"MPU6050": 200.0, "MPU9250": 200.0, "ICM20948": 225.0, "LSM6DSO": 208.0, "BMI270": 200.0}
COMPILER = shutil.which("c++") or shutil.which("g++") or shutil.which("clang++")

pytestmark = pytest.mark.skipif(COMPILER is None, reason="no C++ compiler on this machine")


def _log(chip, folder):
    """Return what a sketch sends, and the truth that its sensor measured."""
    truth = samples()
    config = ",".join(str(7 * i % 251) for i in range(8192))
    (folder / "bmi270_config.h").write_text(f"const uint8_t bmi270_config_file[] PROGMEM = {{{config}}};\n")
    sketch = LIBRARY / "examples" / chip / f"{chip}.ino"
    includes = [f"-I{path}" for path in (ROOT / "tests" / "fake_arduino", LIBRARY / "src", folder)]
    source = ROOT / "tests" / "fake_arduino" / "main.cpp"
    options = ["-std=c++11", "-Wall", "-Wextra", "-Werror", f"-D{chip}", f'-DSKETCH="{sketch}"', *includes]
    subprocess.run([COMPILER, *options, str(source), "-o", str(folder / "run")], check=True)
    warm = np.full((len(truth.t), 1), 31.5)
    given = "\n".join(" ".join(f"{x:.9g}" for x in row) for row in np.hstack([truth.force, truth.rate, warm]))
    done = subprocess.run([folder / "run"], input=given.encode(), capture_output=True, check=True, timeout=60)
    return done.stdout, truth


@pytest.mark.parametrize("chip", RATES_HZ)
def test_a_sketch_sends_what_its_sensor_measures(chip, tmp_path) -> None:
    sent, truth = _log(chip, tmp_path)
    path = tmp_path / "log.txt"
    path.write_bytes(b"# starting\n" + sent)
    imu = read(path).imus["imu0"]
    assert (imu.accelerometer.unit, imu.gyroscope.unit) == ("m/s^2", "rad/s")
    np.testing.assert_allclose(imu.accelerometer.values, truth.force, atol=0.7e-3)  # half a count, half a decimal
    np.testing.assert_allclose(imu.gyroscope.values, truth.rate, atol=0.17e-3)
    np.testing.assert_allclose(np.diff(imu.accelerometer.t_ns), 1e9 / RATES_HZ[chip], atol=1000)
    assert all(line.split(b",")[8].startswith(b"31.") for line in sent.splitlines())


def test_a_damaged_line_is_left_out_and_told(tmp_path) -> None:
    sent, truth = _log("LSM6DSO", tmp_path)
    rows = sent.splitlines(keepends=True)
    rows[300] = rows[300].replace(b",", b",7", 3)
    path = tmp_path / "log.txt"
    path.write_bytes(b"".join(rows))
    recording = read(path)
    imu = recording.imus["imu0"]
    np.testing.assert_allclose(imu.accelerometer.values, np.delete(truth.force, 300, axis=0), atol=0.7e-3)
    assert any("1 lines with a wrong checksum" in note for note in recording.assumptions)
