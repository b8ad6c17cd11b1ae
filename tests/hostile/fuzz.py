"""Feeds the targets with damaged files for as long as one likes, guided by what code they reach (atheris) or not.

    make fuzz                                       100 000 inputs for every target, where it left off
    python tests/hostile/fuzz.py --runs 2000 npz    one target, fewer inputs
    python tests/hostile/fuzz.py --replay FILE      one finding again, with its traceback

The corpus, the count of inputs and the findings are in .fuzz (or $GNOMON_FUZZ), one folder a target. Without atheris,
which is in the dependency group "fuzz" and is not to be had for every system and Python, the same damages are tried
without guidance. Each finding is a file; its name begins with the name of the target.
"""

import argparse
import hashlib
import importlib.util
import json
import os
import subprocess
import sys
import time
from pathlib import Path
from random import Random
from tempfile import TemporaryDirectory

sys.path.insert(0, str(Path(__file__).parents[1]))

RUNS = 100_000
LONGEST = 200_000
"""Bytes of an input; hangs and memory show with small ones."""
OFTEN = 100
"""Inputs after which a process says how far it came."""
FEW = 3
"""Processes that may end badly one after the other without having tried a single input."""


def main() -> int:
    """Fuzz the targets that are named, or all of them; return 1 if a promise was broken."""
    wanted = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    wanted.add_argument("targets", nargs="*", help="names of targets; all where none is given")
    wanted.add_argument("--runs", type=int, default=RUNS, help="inputs for each target in all")
    wanted.add_argument("--seconds", type=float, default=float("inf"), help="for each target at most")
    wanted.add_argument("--plain", action="store_true", help="without atheris")
    wanted.add_argument("--replay", type=Path, help="a finding")
    wanted.add_argument("--list", action="store_true", help="list the targets, and how far each one is")
    wanted.add_argument("--one", help=argparse.SUPPRESS)
    wanted.add_argument("--begin", type=int, default=0, help=argparse.SUPPRESS)
    options = wanted.parse_args()
    if options.replay:
        return _replay(options.replay)
    if options.one:
        return _inside(options.one, options.begin, options.runs, plain=options.plain)
    from hostile.targets import TARGETS

    names = options.targets or list(TARGETS)
    unknown = [name for name in names if name not in TARGETS]
    if unknown:
        sys.stderr.write(f"there is no target {unknown[0]}; there are {', '.join(TARGETS)}\n")
        return 2
    if options.list:
        for name in names:
            print(f"{name}: {_done(name)} inputs")
        return 0
    guided = not options.plain and importlib.util.find_spec("atheris") is not None
    print(f"{'guided by atheris' if guided else 'without guidance (atheris is not installed)'}; in {_place()}")
    for name in names:
        _fuzz(name, options.runs, options.seconds, plain=not guided)
    found = sorted(_place().glob("*/finding-*"))
    for file in found:
        print(f"broken: {sys.executable} {Path(__file__).name} --replay {file}")
    return 1 if found else 0


def _place() -> Path:
    return Path(os.environ.get("GNOMON_FUZZ", Path(__file__).parents[2] / ".fuzz"))


def _done(name: str) -> int:
    count = _place() / name / "count.json"
    return json.loads(count.read_text())["inputs"] if count.exists() else 0


def _fuzz(name: str, runs: int, seconds: float, *, plain: bool) -> None:
    """Run processes one after the other until enough was tried: one that ends badly says how far it came."""
    folder = _place() / name
    (folder / "corpus").mkdir(parents=True, exist_ok=True)
    begun, before, failed = time.monotonic(), _done(name), 0
    while (done := _done(name)) < runs and time.monotonic() - begun < seconds and failed < FEW:
        command = [sys.executable, __file__, "--one", name, "--begin", str(done), "--runs", str(runs - done)]
        left = None if seconds == float("inf") else max(seconds - (time.monotonic() - begun), 1.0)
        try:
            ended = subprocess.run(
                [*command, *(["--plain"] if plain else [])], capture_output=True, check=False, timeout=left
            )
        except subprocess.TimeoutExpired:
            break
        if ended.returncode:
            (folder / f"log-{done}.txt").write_bytes(ended.stdout + ended.stderr)
            for crash in [*folder.glob("crash-*"), *folder.glob("timeout-*"), *folder.glob("oom-*")]:
                crash.rename(folder / f"finding-{crash.name}")  # what libFuzzer kept when the process died
        failed = failed + 1 if _done(name) == done else 0
    took = time.monotonic() - begun
    print(f"{name}: {_done(name) - before} inputs in {took:.0f} s, {_done(name)} in all", flush=True)


def _inside(name: str, begin: int, runs: int, *, plain: bool) -> int:
    """Try some inputs in this process."""
    with TemporaryDirectory() as scratch:
        if not plain:
            return _guided(name, begin, runs, Path(scratch))
        from hostile.mutations import mutated
        from hostile.promise import address_space
        from hostile.targets import TARGETS

        target = TARGETS[name]
        work, seeds = target.prepare(Path(scratch) / "work"), tuple(target.seeds())
        with address_space():
            for number in range(begin, begin + runs):
                chance = Random(f"{name} {number}")
                _try(target, work, mutated(chance.choice(seeds), target.form, chance, seeds)[:LONGEST])
                _count(name, number + 1, often=number + 1 < begin + runs)
    return 0


def _count(name: str, inputs: int, *, often: bool = True) -> None:
    if not often or inputs % OFTEN == 0:
        (_place() / name / "count.json").write_text(json.dumps({"inputs": inputs}))


def _guided(name: str, begin: int, runs: int, scratch: Path) -> int:
    import atheris

    with atheris.instrument_imports(include=["gnomon"]):
        import gnomon.readers.recordings  # noqa: F401
        from hostile.targets import TARGETS
    from hostile.mutations import mutated

    target = TARGETS[name]
    folder, work, seeds = _place() / name, target.prepare(scratch / "work"), tuple(target.seeds())
    given = scratch / "seeds"
    given.mkdir()
    for number, seed in enumerate(seeds):
        (given / str(number)).write_bytes(seed)

    tried = begin

    def one_input(data: bytes) -> None:
        nonlocal tried
        _try(target, work, data)
        tried += 1
        _count(name, tried, often=tried < begin + runs)

    def damaged(data: bytes, most: int, seed: int) -> bytes:
        chance = Random(seed)
        made = atheris.Mutate(data, most) if not chance.randint(0, 3) else mutated(data, target.form, chance, seeds)
        return made[:most]

    limits = [f"-runs={runs + len(seeds)}", f"-seed={begin + 1}", f"-max_len={LONGEST}", "-rss_limit_mb=4096"]
    places = [f"-artifact_prefix={folder}/", str(folder / "corpus"), str(given)]
    atheris.Setup([sys.argv[0], *limits, "-timeout=60", "-verbosity=0", *places], one_input, custom_mutator=damaged)
    atheris.Fuzz()
    return 0


def _try(target: object, work: Path, data: bytes) -> None:
    from hostile.promise import BrokenPromiseError, keep

    try:
        keep(target, work, data, alarm=True)  # pyright: ignore[reportArgumentType]
    except BrokenPromiseError as error:
        what = hashlib.sha256(_kind(error).encode()).hexdigest()[:12]
        file = _place() / target.name / f"finding-{target.name}-{what}"  # pyright: ignore[reportAttributeAccessIssue]
        file.parent.mkdir(parents=True, exist_ok=True)
        if not file.exists() or len(data) < file.stat().st_size:  # the smallest input of each kind is kept
            file.write_bytes(data)


def _kind(error: BaseException) -> str:
    """Return what tells one finding from another: the exception, and the line in gnomon that it came through last."""
    cause = error.__cause__
    if cause is None:
        return str(error)[:60]
    place, trace = "", cause.__traceback__
    while trace is not None:
        code = trace.tb_frame.f_code
        place = f"{code.co_filename}:{trace.tb_lineno}" if "gnomon" in Path(code.co_filename).parts else place
        trace = trace.tb_next
    return f"{type(cause).__name__} {place}"


def _replay(file: Path) -> int:
    from hostile.promise import keep
    from hostile.targets import TARGETS

    name = file.parent.name
    with TemporaryDirectory() as scratch:
        refused = keep(TARGETS[name], TARGETS[name].prepare(Path(scratch)), file.read_bytes())
    print(f"{name}: {'read' if refused is None else f'refused: {refused}'}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
