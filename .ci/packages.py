"""Build wheel and sdist, look whether everything is in them, and calibrate with the wheel alone.

Run as `python .ci/packages.py` where the group `dev` is installed; the wheel gets an environment of its own.
"""

import os
import subprocess
import sys
import tarfile
import tempfile
import venv
import zipfile
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
IN_SDIST = ("pyproject.toml", "README.md", "LICENSE", "CHANGELOG.md", "Makefile", "src/gnomon/py.typed")


def run(*command: object, where: Path = ROOT) -> None:
    """Run a program, and show what it said only where it fails."""
    done = subprocess.run([str(word) for word in command], cwd=where, capture_output=True, check=False)
    if done.returncode:
        sys.stderr.buffer.write(done.stdout + done.stderr)
        sys.exit(f"{' '.join(map(str, command))} ended with exit code {done.returncode}")


def look_inside(dist: Path) -> Path:
    """Stop where wheel or sdist lack something, and return the wheel."""
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
    return wheel


def calibrate(wheel: Path, place: Path) -> None:
    """Install the wheel, without the source tree, and calibrate the simulated recording."""
    venv.create(place / "venv", symlinks=os.name != "nt")
    programs = place / "venv" / ("Scripts" if os.name == "nt" else "bin")
    python = programs / ("python.exe" if os.name == "nt" else "python")
    run(sys.executable, "-m", "pip", "--python", python, "install", "--quiet", "--disable-pip-version-check", wheel)
    run(programs / "gnomon", "demo", "-o", place / "demo", where=place)
    assert (place / "demo" / "report.html").stat().st_size > 0, "the demo has no report"
    print("packages: the installed wheel calibrates")


with tempfile.TemporaryDirectory() as scratch:
    # hatchling is in the group `dev`: an environment for it would have to be made twice
    run(sys.executable, "-m", "build", "--no-isolation", "--outdir", scratch, ".")
    calibrate(look_inside(Path(scratch)), Path(scratch))
