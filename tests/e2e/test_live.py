"""gnomon live from the command line: the recording that it leaves is one that gnomon imu reads."""

from itertools import islice

import pytest

from gnomon.cli import main
from gnomon.live.hand import FIRST_REST_S, SimulatedHand


@pytest.mark.long
def test_the_result_is_that_of_the_ordinary_command(tmp_path, capsys):
    hand = SimulatedHand(6)
    count = round((FIRST_REST_S + 18 * 4.5) * hand.rate_hz)
    log = tmp_path / "log.txt"
    log.write_bytes(b"".join(line + b"\n" for line in islice(hand.sample_lines(), count)))
    folder, again = tmp_path / "monday", tmp_path / "again"
    code = main(
        [
            "live",
            "imu",
            f"tail:{log}",
            "--for",
            "ahrs",
            "--no-browser",
            "--until-enough",
            "--no-report",
            "-o",
            str(folder),
        ]
    )
    assert code == 0
    assert main(["imu", str(folder), "--for", "ahrs", "--no-report", "-o", str(again)]) == 0
    told = capsys.readouterr()
    assert "Enough" in told.err
    live = tmp_path / "monday-imu" / "calibration.yaml"
    assert live.read_bytes() == (again / "calibration.yaml").read_bytes()


@pytest.mark.long
def test_the_lens_is_that_of_the_ordinary_command(tmp_path, capsys):
    made, folder, again = tmp_path / "made", tmp_path / "lens", tmp_path / "again"
    shown = ["--images", "--views", "24", "--rate-hz", "10", "--resolution", "320", "240"]
    lens = ["--intrinsics", "210", "210", "159", "119", "--distortion-coeffs", "-0.1", "0.02", "0", "0"]
    assert main(["simulate", "cameras", "-o", str(made), "--fill", "0.4", "0.7", *shown, *lens]) == 0
    live = ["live", "camera", f"replay:{made}@4", "--no-browser", "--until-enough", "--no-report", "-o", str(folder)]
    assert main(live) in {0, 1}
    assert main(["camera", str(folder), "--no-report", "-o", str(again)]) in {0, 1}
    assert "24 images" in capsys.readouterr().out
    result = tmp_path / "lens-camera" / "calibration.yaml"
    assert result.read_bytes() == (again / "calibration.yaml").read_bytes()


@pytest.mark.long
def test_the_rig_is_that_of_the_ordinary_command(tmp_path, capsys):
    made, folder, again = tmp_path / "made", tmp_path / "rig", tmp_path / "again"
    small = ["--images", "--resolution", "320", "240", "--intrinsics", "230", "229", "161", "118"]
    brief = ["--duration-s", "20", "--camera-rate-hz", "5", "--distortion-coeffs", "-0.1", "0.02", "0", "0"]
    assert main(["simulate", "camera-imu", "-o", str(made), *small, *brief]) == 0
    live = ["live", "camera-imu", f"replay:{made}@4", "--no-browser", "--until-enough", "--no-report"]
    assert main([*live, "-o", str(folder)]) in {0, 1}
    assert main(["camera-imu", str(folder), "--no-report", "-o", str(again)]) in {0, 1}
    assert "recorded" in capsys.readouterr().out
    result = tmp_path / "rig-camera-imu" / "calibration.yaml"
    assert result.read_bytes() == (again / "calibration.yaml").read_bytes()


def test_a_camera_without_a_board_is_refused_before_anything_is_made(tmp_path, capsys):
    assert main(["live", "camera", "camera:0", "-o", str(tmp_path / "x")]) == 2
    assert "--target is missing" in capsys.readouterr().err
    assert not (tmp_path / "x").exists()


def test_a_source_that_is_none_is_refused_before_anything_is_made(tmp_path, capsys):
    assert main(["live", "imu", "usb:3", "-o", str(tmp_path / "x")]) == 2
    assert "serial:PORT" in capsys.readouterr().err
    assert not (tmp_path / "x").exists()
