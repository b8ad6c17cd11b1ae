"""Build wheel and sdist, look whether everything is in them, and calibrate with the wheel alone; then try the extras.

What pip builds of the sdist has to be that wheel, file by file: to calibrate with it again would tell nothing.

Run as `python .ci/packages.py [PYTHON]` where the group `dev` is installed; the wheel gets an environment of its own,
of PYTHON where that is named.
"""

import os
import subprocess
import sys
import tarfile
import tempfile
import zipfile
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
PYTHON = (sys.argv[1:] or [sys.executable])[0]
EXTRAS = "[certificate,dask,fleet,serve,live,tls]"
PIP = (sys.executable, "-m", "pip", "--quiet", "--disable-pip-version-check")
IN_SDIST = ("pyproject.toml", "README.md", "LICENSE", "CHANGELOG.md", "Makefile", "src/gnomon/py.typed")


def run(*command: object, where: Path = ROOT) -> None:
    """Run a program, and show what it said only where it fails."""
    done = subprocess.run([str(word) for word in command], cwd=where, capture_output=True, check=False)
    if done.returncode:
        sys.stderr.buffer.write(done.stdout + done.stderr)
        sys.exit(f"{' '.join(map(str, command))} ended with exit code {done.returncode}")


def look_inside(dist: Path) -> tuple[Path, Path]:
    """Stop where wheel or sdist lack something, and return both."""
    (wheel,), (sdist,) = dist.glob("gnomon-*.whl"), dist.glob("gnomon-*.tar.gz")
    with zipfile.ZipFile(wheel) as archive:
        packed = set(archive.namelist())
    source = ROOT / "src"
    files = {path.relative_to(source).as_posix() for path in (source / "gnomon").rglob("*") if path.is_file()}
    wanted = {name for name in files if "__pycache__" not in name and "/." not in name}
    assert "gnomon/py.typed" in wanted, "py.typed is missing"
    assert any(name.endswith(".jinja") for name in wanted), "the report's templates are missing"
    assert wanted <= packed, f"not in the wheel: {sorted(wanted - packed)}"
    with tarfile.open(sdist) as archive:
        entries = archive.getnames()
    for name in IN_SDIST:
        assert any(entry.endswith(f"/{name}") for entry in entries), f"not in the sdist: {name}"
    print(f"packages: wheel {len(packed)} files, sdist {len(entries)} files")
    return wheel, sdist


def install(package: Path, place: Path, extras: str = "") -> Path:
    """Install a package, without the source tree, into an environment of its own; return the program."""
    programs = place / ("Scripts" if os.name == "nt" else "bin")
    python = programs / ("python.exe" if os.name == "nt" else "python")
    if not python.exists():
        run(PYTHON, "-m", "venv", "--without-pip", place)
    # With the pip that is here; what is imported is compiled then, a tenth of what is installed.
    run(*PIP, "--python", python, "install", "--no-compile", f"{package}{extras}")
    return programs / "gnomon"


def contents(wheel: Path) -> dict[str, bytes]:
    """Return the files of a wheel, but for what tells of its making, and for what a compiler made."""
    with zipfile.ZipFile(wheel) as archive:
        names = [name for name in archive.namelist() if not name.endswith(("/RECORD", "/WHEEL"))]
        return {name: b"" if "/compiled/" in name else archive.read(name) for name in names}


def build_sdist(sdist: Path, wheel: Path, place: Path) -> None:
    """Stop where what pip makes of the sdist, as for somebody who has no wheel, is not the wheel."""
    run(*PIP, "wheel", "--no-deps", "--wheel-dir", place, sdist)
    made, wanted = contents(next(place.glob("gnomon-*.whl"))), contents(wheel)
    differ = {name for name in made.keys() | wanted.keys() if made.get(name) != wanted.get(name)}
    assert not differ, f"pip makes something else of the sdist: {sorted(differ)}"
    print("packages: pip makes the wheel of the sdist")


def calibrate(gnomon: Path, place: Path) -> None:
    """Calibrate an IMU and a camera in `place`, and convert what comes of it."""
    place.mkdir()
    run(gnomon, "demo", "-o", "demo", where=place)
    assert (place / "demo" / "report.html").stat().st_size > 0, "the demo has no report"
    run(gnomon, "simulate", "cameras", "-o", "views", where=place)
    run(gnomon, "camera", "views", "-o", "lens", where=place)
    run(gnomon, "imu", "demo/recording.npz", "--serial", "1", "-o", "imu", where=place)
    run(gnomon, "convert", "imu/calibration.yaml", "--to", "px4", "-o", "params", where=place)
    print(f"packages: the installed {place.name} calibrates")


def use_extras(gnomon: Path, place: Path) -> None:
    """Use what extras bring: a certificate, a library of devices, a page."""
    run(gnomon, "certificate", "imu", "-o", "imu.pdf", where=place)
    run(gnomon, "library", "import", "imu", "--library", "devices.db", where=place)
    run(gnomon, "library", "list", "--library", "devices.db", where=place)
    run(gnomon.with_name("python"), "-c", "import cryptography, distributed, segno, serial, starlette, uvicorn")
    print(f"packages: {EXTRAS} work")


with tempfile.TemporaryDirectory() as scratch:
    folder = Path(scratch)
    # hatchling is in the group `dev`: an environment for it would have to be made twice
    run(sys.executable, "-m", "build", "--no-isolation", "--outdir", folder, ".")
    wheel, sdist = look_inside(folder)
    alone = install(wheel, folder / "venv")
    calibrate(alone, folder / "wheel")
    build_sdist(sdist, wheel, folder / "of-sdist")
    install(wheel, folder / "venv", EXTRAS)
    use_extras(alone, folder / "wheel")
