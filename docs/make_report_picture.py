"""Make the picture of a report that the README shows.

    python docs/make_report_picture.py gnomon-demo/report.html docs/report.png

The picture is 1200 pixels wide and shows the top of the report as a desktop browser does. Needs a Chromium.
"""

import argparse
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

WIDTH, HEIGHT = 1200, 1500


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


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("report", type=Path, help="report.html")
    parser.add_argument("picture", type=Path, help="PNG file to write")
    parser.add_argument("--height", type=int, default=HEIGHT, help="height in pixels (default %(default)s)")
    arguments = parser.parse_args()
    make_picture(arguments.report, arguments.picture, arguments.height)
