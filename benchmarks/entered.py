"""How many files of the package a command loads, and in how many a function is called: what a reader of it opens.

    python benchmarks/entered.py imu RECORDING -o FOLDER

Also --list tells the files. Bodies of classes and modules, which run when a file is loaded, do not count as calls; nor
do comprehensions, generator expressions and lambdas, which belong to the function or the module around them.
"""

import sys
from collections import Counter
from pathlib import Path
from types import FrameType

from gnomon.__main__ import main

PACKAGE = Path(sys.modules["gnomon"].__file__ or "").parent
OPTIMIZED = 1  # flag of code that is a function (inspect.CO_OPTIMIZED)


def files_entered(words: list[str]) -> tuple[set[str], Counter[str]]:
    """Run a command, and return which files were loaded, and how often functions of each were called."""
    calls = Counter[str]()

    def count(frame: FrameType, event: str, _: object) -> None:
        code = frame.f_code
        if event == "call" and code.co_flags & OPTIMIZED and not code.co_name.startswith("<"):
            calls[code.co_filename] += 1

    sys.argv = ["gnomon", *words]
    sys.setprofile(count)
    try:
        main()
    except SystemExit as end:
        if end.code:
            raise
    finally:
        sys.setprofile(None)
    loaded = {str(Path(module.__file__)) for module in list(sys.modules.values()) if getattr(module, "__file__", None)}
    own = {path for path in loaded if PACKAGE in Path(path).parents}
    return own, Counter({path: count for path, count in calls.items() if path in own})


if __name__ == "__main__":
    given, listed = [word for word in sys.argv[1:] if word != "--list"], "--list" in sys.argv
    loaded, called = files_entered(given)
    for path in sorted(called) if listed else ():
        print(f"{called[path]:8d}  {Path(path).relative_to(PACKAGE)}")
    print(f"{len(loaded)} files loaded, {len(called)} with a function that is called")
