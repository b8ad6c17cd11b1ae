"""Compiles src/gnomon/kernel/kernel.c while the package is built; without it the package is pure Python, and slower.

`python hatch_build.py` does it in place. The compiler is that of CC, else the one that Python was built with.
"""

import ctypes
import os
import shlex
import subprocess
import sys
import sysconfig
from pathlib import Path
from typing import Any

try:
    from hatchling.builders.hooks.plugin.interface import BuildHookInterface as Hook
except ModuleNotFoundError:  # run as a script, where nothing is built
    Hook = object

FOLDER = Path(__file__).parent / "src" / "gnomon" / "kernel"
LIBRARY = FOLDER / "compiled" / ("kernel." + {"win32": "dll", "darwin": "dylib"}.get(sys.platform, "so"))
FRESH = LIBRARY.with_stem("fresh")
"""It takes the place of the other at once: a program that starts meanwhile finds either."""


def commands() -> list[list[str]]:
    """Return what compiles the kernel, one after the other until one does."""
    source, output = str(FOLDER / "kernel.c"), str(FRESH)
    stated = os.environ.get("CC") or sysconfig.get_config_var("CC")
    flags = ["-O3", "-fno-trapping-math", "-std=c99", "-fPIC", "-shared", "-fvisibility=hidden"]
    flags += shlex.split(os.environ.get("ARCHFLAGS", ""))
    found = [
        [*shlex.split(compiler), *flags, source, "-o", output, "-lm"]
        for compiler in ([stated] if os.environ.get("CC") else [stated, "cc", "gcc", "clang"])
        if compiler
    ]
    if sys.platform == "win32":
        found.insert(0, ["cl", "/nologo", "/O2", "/LD", source, f"/Fo{FRESH.parent}\\", f"/Fe{output}"])
    return found


def compiled() -> bool:
    """Compile the kernel beside its source, and tell whether that worked; nothing is left where it did not."""
    FRESH.parent.mkdir(exist_ok=True)
    for command in commands():
        try:
            subprocess.run(command, check=True, capture_output=True, timeout=300)
            ctypes.CDLL(str(FRESH)).gnomon_interface()
            FRESH.replace(LIBRARY)
        except (OSError, subprocess.SubprocessError, AttributeError):
            FRESH.unlink(missing_ok=True)
        else:
            return True
        finally:
            for suffix in (".obj", ".lib", ".exp"):
                FRESH.with_suffix(suffix).unlink(missing_ok=True)
    LIBRARY.unlink(missing_ok=True)
    return False


class KernelHook(Hook):
    """Makes the wheel one of this platform where the kernel was compiled."""

    def initialize(self, version: str, build_data: dict[str, Any]) -> None:
        """Compile the kernel; the wheel stays pure Python upon any failure."""
        if not compiled():
            print("gnomon: no C compiler that works; the kernel is left out", file=sys.stderr)
        elif version != "editable":
            platform = sysconfig.get_platform().replace("-", "_").replace(".", "_")
            build_data |= {"pure_python": False, "tag": f"py3-none-{platform}"}
            build_data["force_include"][str(LIBRARY)] = f"gnomon/kernel/compiled/{LIBRARY.name}"


if __name__ == "__main__":
    print(f"compiled {LIBRARY}" if compiled() else "no C compiler that works")
