"""Make the pictures of reports that the README shows.

    python docs/make_report_picture.py                                          both, from simulated recordings
    python docs/make_report_picture.py gnomon-demo/report.html docs/report.png  one, of any report

A picture is 1200 pixels wide and shows the top of the report as a desktop browser does. Needs a Chromium.
"""

import argparse
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

from gnomon.cli import main as gnomon

WIDTH, HEIGHT = 1200, 1475
DOCS = Path(__file__).parent


def find_chromium() -> str:
    """Return the path of a Chromium or Chrome; ends the program with a message where there is none."""
    for name in ("chromium", "chromium-browser", "google-chrome"):
        path = shutil.which(name)
        if path:
            return path
    sys.exit("No chromium, chromium-browser or google-chrome was found on the PATH. Install one of them.")


def make_picture(report: Path, picture: Path, height: int = HEIGHT) -> None:
    """Write the top of a report, so many pixels high, as a PNG file."""
    with tempfile.TemporaryDirectory() as profile:
        command = [
            find_chromium(),
            "--headless",
            "--no-sandbox",
            "--disable-gpu",
            "--disable-background-networking",
            "--disable-component-update",
            "--disable-sync",
            "--no-first-run",
            "--hide-scrollbars",
            f"--user-data-dir={profile}",
            f"--window-size={WIDTH},{height}",
            f"--screenshot={picture.resolve()}",
            report.resolve(strict=True).as_uri(),
        ]
        subprocess.run(command, check=True, capture_output=True, timeout=60)


def make_both() -> None:
    """Write the pictures of the README from the demonstration and from the tutorial's camera-IMU recording."""
    with tempfile.TemporaryDirectory() as place:
        folder = Path(place)
        _run("demo", "-o", str(folder / "demo"))
        recording = str(folder / "recording")
        _run("simulate camera-imu", "-o", recording, "--seed", "1")
        _run("camera-imu", recording, "--gravity", "9.80665", "-o", str(folder / "rig"))
        make_picture(folder / "demo" / "report.html", DOCS / "report.png")
        make_picture(folder / "rig" / "report.html", DOCS / "report-camera-imu.png", 1300)


def _run(*arguments: str) -> None:
    if code := gnomon(arguments):
        sys.exit(code)


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("report", type=Path, nargs="?", help="report.html; both pictures of the README without it")
    parser.add_argument("picture", type=Path, nargs="?", help="PNG file to write")
    parser.add_argument("--height", type=int, default=HEIGHT, help="height in pixels (default %(default)s)")
    arguments = parser.parse_args()
    if arguments.report is None:
        make_both()
    elif arguments.picture is None:
        parser.error("a report needs the PNG file to write")
    else:
        make_picture(arguments.report, arguments.picture, arguments.height)
