"""Make the gallery of good and bad recordings: docs/gallery.md and the pictures in docs/gallery/.

    python docs/make_gallery.py                  all of it, from simulated recordings; some minutes
    python docs/make_gallery.py board-moved      one of its entries
    python docs/make_gallery.py --no-pictures    the page alone, with the pictures that are there

Every recording is one of the catalogue of faults (tests/support/faults.py), simulated and calibrated as its owner
would; titles and symptoms are the catalogue's, and what is quoted is what gnomon said. A picture shows one figure of
that recording's report. Needs a Chromium for them.
"""

import argparse
import re
import subprocess
import sys
import tempfile
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import cv2
import numpy as np

from gnomon import GnomonError, Result, calibrate_camera_imu, calibrate_imu, write_report
from gnomon.findings import Finding
from gnomon.options import CameraImuOptions

DOCS = Path(__file__).resolve().parent
sys.path[:0] = [str(DOCS), str(DOCS.parent / "tests")]

from make_report_picture import find_chromium  # noqa: E402

from support.fault_recordings import sound_recording  # noqa: E402
from support.faults import Fault, FaultyRecording, fault_named, faults, simulate_fault  # noqa: E402

PAGE, PICTURES = DOCS / "gallery.md", DOCS / "gallery"
SEED = 1
MOST_BYTES = 60_000
LOUD = ("problem", "warning")
WIDTH_PX, BORDER_PX = 860, 12


@dataclass(frozen=True, slots=True)
class Shown:
    """A figure of a report: how its title begins, and from where to where its height is shown (0 to 1)."""

    title: str
    top: float = 0.0
    bottom: float = 1.0


SHOWN = {
    "sound-imu": Shown("Error of the magnitude of specific force"),
    "sound-rig": Shown("Frames of cam0"),
    "gyroscope-clips": Shown("Signals and static detector", 0.37, 0.68),
    "accelerometer-warms-up": Shown("Error of the magnitude of specific force"),
    "rig-accelerometer-clips": Shown("Accelerometer over the recording", 0.0, 0.56),
    "board-moved": Shown("Frames of cam0"),
    "distortion-missing": Shown("Mean residual over the image"),
    "turned-about-one-axis": Shown("Axes of rotation"),
    "vibration": Shown("Accelerometer over the recording", 0.0, 0.56),
    "rig-gyroscope-warms-up": Shown("About their means"),
}
"""Recordings that have a picture."""

HEAD = """\
<!-- Made by docs/make_gallery.py; do not edit. -->

# Gallery: good and bad recordings

What recordings look like with one thing wrong with them, and what gnomon says of each. All are simulated, so that what
is wrong is known; codes are explained [by symptom](symptoms.md). `python docs/make_gallery.py` makes them again.
"""

SECTIONS = {
    "imu": ("An IMU alone", "Turned by hand into some forty attitudes, with rests between."),
    "camera-imu": ("Cameras and an IMU", "Waved by hand before an AprilGrid, for most of a minute."),
}


@dataclass(frozen=True, slots=True, kw_only=True)
class Entry:
    """One recording of the gallery.

    Attributes
    ----------
    name : such as "gyroscope-clips"
    title, symptom : what is wrong, and what its owner sees
    said : what gnomon says, as Markdown
    verdict : of the calibration; "" where there is none
    picture : name of the file in docs/gallery/; "" for none
    """

    name: str
    title: str
    symptom: str
    said: str
    verdict: str
    picture: str


def make_gallery(*, pictures: bool) -> None:
    """Write the page and, if wanted, its pictures."""
    PICTURES.mkdir(exist_ok=True)
    parts = [HEAD, "## By symptom"]
    for kind, (title, _) in SECTIONS.items():
        rows = [f"| {fault.symptom} | [{_title(fault)}](#{_anchor(_title(fault))}) |" for fault in _of(kind)]
        parts.append(f"**{title}:**\n\n| what you see | what is wrong |\n|---|---|\n" + "\n".join(rows))
    for kind, (title, lead) in SECTIONS.items():
        own = _of(kind)
        parts += [f"## {title}", lead, *_text(_sound(own[0], pictures=pictures))]
        for fault in own:
            sys.stderr.write(f"{fault.name}\n")
            parts += _text(faulty_entry(fault, pictures=pictures))
    PAGE.write_text("\n\n".join(part.strip("\n") for part in parts) + "\n", encoding="utf-8", newline="\n")


def _of(kind: str) -> list[Fault]:
    return [fault for fault in faults() if fault.kind == kind]


def _title(fault: Fault) -> str:
    """Return the title of a fault, which no other of the page has."""
    alike = [other for other in faults() if other.title == fault.title]
    return fault.title.replace("²", "^2") + (", beside a camera" if len(alike) > 1 and fault != alike[0] else "")


def faulty_entry(fault: Fault, *, pictures: bool) -> Entry:
    """Return a recording of the catalogue, calibrated."""
    case = simulate_fault(fault.name, SEED)
    try:
        result = _calibrated(case)
    except GnomonError as error:
        said, verdict, picture = _wrapped(f"> {error}"), "", ""
    else:
        said, verdict = _said(fault, result), result.calibration.verdict
        picture = _picture(fault.name, result, make=pictures)
    return Entry(
        name=fault.name, title=_title(fault), symptom=fault.symptom, said=said, verdict=verdict, picture=picture
    )


def _said(fault: Fault, result: Result) -> str:
    """Return what a calibration says of a fault: what names it, else what the model took up, else what is worst."""
    assessment = result.calibration.assessment
    named = [finding for finding in assessment.findings if _names(fault, finding)]
    if named:
        return _quoted(named[0])
    if taken_up := [finding for finding in assessment.findings if finding.code.endswith("-found")]:
        return "\n>\n".join(map(_quoted, taken_up))
    loud = [finding for finding in assessment.findings if finding.severity in LOUD]
    return _quoted(loud[0]) if loud else "> nothing of it"


def _sound(like: Fault, *, pictures: bool) -> Entry:
    """Return a recording with nothing wrong with it, as that of a fault would be without it."""
    name = "sound-imu" if like.kind == "imu" else "sound-rig"
    result = _calibrated(sound_recording(replace(like, spoil=None).scenario, SEED))
    findings = result.calibration.assessment.findings
    loud = [finding for finding in findings if finding.severity in LOUD]
    good = [finding for finding in findings if finding.severity == "good"]
    return Entry(
        name=name,
        title="Nothing is wrong" if like.kind == "imu" else "Nothing is wrong with the rig",
        symptom="Errors are as small as the sensor's noise, from the first interval to the last."
        if like.kind == "imu"
        else "Corners fit to their noise in every frame, fast ones too.",
        said="\n>\n".join(_quoted(finding) for finding in [*loud, *good][:2]),
        verdict=result.calibration.verdict,
        picture=_picture(name, result, make=pictures),
    )


def _calibrated(case: FaultyRecording) -> Result:
    if isinstance(case.options, CameraImuOptions):
        assert case.target is not None
        return calibrate_camera_imu(case.recording, case.target, case.options)
    return calibrate_imu(case.recording, case.options)


def _names(fault: Fault, finding: Finding) -> bool:
    return finding.code in fault.codes and all(re.search(pattern, str(finding)) for pattern in fault.says)


def _text(entry: Entry) -> Iterator[str]:
    """Yield the paragraphs of an entry."""
    yield f"### {entry.title}"
    yield _filled(entry.symptom)
    if entry.picture:
        yield f"![{SHOWN[entry.name].title}: {entry.title}](gallery/{entry.picture})"
    verdict = f"Verdict {entry.verdict}:" if entry.verdict else "gnomon ends with:"
    yield f"{verdict}\n\n{entry.said}"


def _quoted(finding: Finding) -> str:
    code = f"[`{finding.code}`](symptoms.md#code-{finding.code})"
    cure = f" **{finding.cure}**" if finding.cure else ""
    return _wrapped(f"> {finding.severity}, {code}: {finding.message} {finding.consequence}{cure}")


def _anchor(title: str) -> str:
    return re.sub(r"[^\w\- ]", "", title.lower()).replace(" ", "-")


def _wrapped(text: str) -> str:
    return "\n> ".join(_lines(text))


def _filled(text: str) -> str:
    return "\n".join(_lines(text))


def _lines(text: str, width: int = 118) -> list[str]:
    lines = [""]
    for word in text.split():
        if len(lines[-1]) + len(word) >= width:
            lines.append("")
        lines[-1] = f"{lines[-1]} {word}".strip()
    return lines


def _picture(name: str, result: Result, *, make: bool) -> str:
    """Return the name of a recording's picture, made anew where wanted; "" where it shall have none."""
    if name not in SHOWN:
        return ""
    path = PICTURES / f"{name}.png"
    if make:
        with tempfile.TemporaryDirectory() as place:
            report = Path(place) / "report.html"
            write_report(result, report)
            _draw(_figure_of(report.read_text(encoding="utf-8"), SHOWN[name].title), SHOWN[name], path)
    return path.name if path.exists() else ""


def _figure_of(report: str, title: str) -> str:
    """Return a page with nothing but one figure of a report.

    Raises
    ------
    SystemExit
        If the report has no such figure.
    """
    figures = re.findall(r"<figure>.*?</figure>", report, re.DOTALL)
    titles = [match.group(1) for figure in figures if (match := re.search(r"<h3>(.*?)</h3>", figure))]
    if not any(found.startswith(title) for found in titles):
        sys.exit(f"No figure begins with {title!r}; there are {', '.join(titles)}.")
    figure = figures[next(i for i, found in enumerate(titles) if found.startswith(title))]
    figure = re.sub(r"<figcaption>.*?</figcaption>", "", figure, flags=re.DOTALL)
    style = report.partition("<style>")[2].partition("</style>")[0]
    return f'<!doctype html><meta charset="utf-8"><style>{style} body {{ padding: 16px 24px }}</style>{figure}'


def _draw(page: str, shown: Shown, path: Path) -> None:
    """Write what is shown of a page as a PNG file, without the white around it."""
    with tempfile.TemporaryDirectory() as place:
        html, picture = Path(place) / "figure.html", Path(place) / "figure.png"
        html.write_text(page, encoding="utf-8")
        command = [
            find_chromium(),
            "--headless",
            "--no-sandbox",
            "--disable-gpu",
            "--disable-background-networking",
            "--no-first-run",
            "--hide-scrollbars",
            f"--user-data-dir={place}/profile",
            f"--window-size={WIDTH_PX},2000",
            f"--screenshot={picture}",
            html.as_uri(),
        ]
        subprocess.run(command, check=True, capture_output=True, timeout=60)
        image = cv2.imread(str(picture))
    assert image is not None
    whole = _trimmed(image)
    part = slice(round(shown.top * len(whole)), round(shown.bottom * len(whole)))
    _save(_trimmed(whole[part]), path)


def _trimmed(image: np.ndarray) -> np.ndarray:
    rows, columns = (np.flatnonzero((image != 255).any(axis=2).any(axis=axis)) for axis in (1, 0))
    top, left = max(rows[0] - BORDER_PX, 0), max(columns[0] - BORDER_PX, 0)
    return image[top : rows[-1] + BORDER_PX, left : columns[-1] + BORDER_PX]


def _save(image: np.ndarray, path: Path) -> None:
    """Write a PNG file with as many shades as its size allows."""
    for shades in (256, 32, 16, 8):
        step = 256 // shades
        coarse = image if step == 1 else np.minimum(np.round(image / step) * step, 255).astype(np.uint8)
        cv2.imwrite(str(path), coarse, [cv2.IMWRITE_PNG_COMPRESSION, 9])
        if path.stat().st_size < MOST_BYTES:
            return
    sys.exit(f"{path.name} has {path.stat().st_size} bytes; show a smaller figure.")


def update(names: Sequence[str], *, pictures: bool) -> None:
    """Make some entries of the page anew."""
    page = PAGE.read_text(encoding="utf-8")
    for name in names:
        entry = faulty_entry(fault_named(name), pictures=pictures)
        before, title, rest = page.partition(f"\n### {entry.title}\n")
        if not title:
            sys.exit(f"{PAGE.name} has no entry {entry.title!r}; make the whole page.")
        after = re.search(r"\n##", rest)
        page = before + "\n" + "\n\n".join(_text(entry)) + "\n" + (rest[after.start() :] if after else "")
    PAGE.write_text(page, encoding="utf-8", newline="\n")


def main(arguments: Sequence[str] | None = None) -> None:
    """Write the gallery."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("names", nargs="*", metavar="NAME", help="recordings to make anew (default: all)")
    parser.add_argument("--no-pictures", action="store_true", help="keep the pictures as they are")
    options = parser.parse_args(arguments)
    if options.names:
        update(options.names, pictures=not options.no_pictures)
    else:
        make_gallery(pictures=not options.no_pictures)


if __name__ == "__main__":
    main()
