"""Costs in instructions, beside those of an earlier commit: `make instructions`.

A count needs no quiet machine and no bursts: it repeats within a small part of a percent.
callgrind (`apt install valgrind`) counts the rows of `counted.py`, which are arithmetic, with the
code of this checkout and with that of the last tag, or of `--against REV`, in pinned processes. The
exit code is 1 if a row takes over MORE times the instructions of that commit. Without callgrind, or
without a compiler for the requests to it, a line says what is missing, and the exit code is 0. An
instruction is not a time: latency, processor time of daemons and start-up have budgets of time
(`budget.py`).
"""

from __future__ import annotations

import argparse
import re
import shutil
import subprocess
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path
from tempfile import TemporaryDirectory

from benchmarks.table import markdown
from studies.behaviour.__main__ import built
from swarmd.core.errors import ConfigError, SwarmError
from swarmd.core.pin import pinned_environment

ROOT = Path(__file__).resolve().parent.parent
PROGRAM = Path(__file__).with_name("counted.py")
MORE = 1.02
"""The largest ratio to the earlier commit that holds."""
_REQUESTS = """
#include <valgrind/callgrind.h>
void start(void) { CALLGRIND_START_INSTRUMENTATION; }
void begin(void) { CALLGRIND_TOGGLE_COLLECT; }
void end(void) { CALLGRIND_TOGGLE_COLLECT; }
void dump(const char *name) { CALLGRIND_DUMP_STATS_AT(name); CALLGRIND_STOP_INSTRUMENTATION; }
"""
_NAME = re.compile(r"^desc: Trigger: Client Request: (.+) / (\d+)$", re.MULTILINE)
# Not the line `summary`: callgrind 3.19 writes a negative one, as 64 bits, after earlier dumps.
_SUM = re.compile(r"^totals: (\d+)", re.MULTILINE)


def missing() -> str:
    """What this machine lacks to count instructions, with the remedy; empty if it lacks nothing."""
    if shutil.which("valgrind") is None:
        return "callgrind is not installed: apt install valgrind"
    if shutil.which("cc") is None:
        return "a compiler of C is not installed: apt install gcc"
    return ""


def counted(parts: Sequence[str]) -> dict[str, float]:
    """Instructions of a call by row, from what callgrind has written, a text for each dump."""
    found = {}
    for text in parts:
        name = _NAME.search(text)
        total = _SUM.search(text)
        if name is not None and total is not None:
            found[name[1]] = int(total[1]) / int(name[2])
    return found


def ratios(now: Mapping[str, float], before: Mapping[str, float]) -> dict[str, float | None]:
    """By row of `now`, the ratio to `before`; None for a row that the earlier commit lacks."""
    return {name: count / before[name] if before.get(name) else None for name, count in now.items()}


def over(found: Mapping[str, float | None]) -> list[str]:
    """The rows whose ratio does not hold, with how much is too much for each."""
    return [
        f"{name}: {100.0 * (ratio - 1.0):+.1f} %"
        for name, ratio in found.items()
        if ratio is not None and ratio > MORE
    ]


def count_in(checkout: Path, folder: Path) -> dict[str, float]:
    """Count the rows with the code of a checkout; `folder`: for what callgrind writes.

    A row that an earlier commit cannot do is left out, with a line on the standard error.
    SwarmError if this checkout cannot do one.
    """
    folder.mkdir(parents=True)
    library = folder / "requests.so"
    subprocess.run(
        ["cc", "-shared", "-fPIC", "-O2", "-x", "c", "-o", str(library), "-"],
        input=_REQUESTS,
        text=True,
        check=True,
    )
    environment = pinned_environment()
    environment |= {"PYTHONPATH": str(checkout), "OPENBLAS_NUM_THREADS": "1", "PYTHONHASHSEED": "0"}
    tool = ["valgrind", "--quiet", "--tool=callgrind", "--instr-atstart=no", "--collect-atstart=no"]
    program = [sys.executable, "-P", str(PROGRAM), str(library), str(folder)]
    done = subprocess.run(
        [*tool, f"--callgrind-out-file={folder / 'out'}", *program],
        cwd=checkout,
        env=environment,
        check=False,
    )
    errors = [f"{one.stem}: {one.read_text().strip()}" for one in sorted(folder.glob("*.error"))]
    if done.returncode:
        errors.append(f"the program ended with {done.returncode}")
    if errors and checkout == ROOT:
        raise SwarmError("; ".join(errors))
    for text in errors:
        print(f"{checkout.name[:8]}: {text}", file=sys.stderr)
    return counted([one.read_text() for one in sorted(folder.glob("out.*"))])


def last_tag() -> str:
    """The newest tag of this history; ConfigError without one: tags do not travel with a clone."""
    words = ["git", "-C", str(ROOT), "describe", "--tags", "--abbrev=0"]
    done = subprocess.run(words, capture_output=True, text=True, check=False)
    if done.returncode:
        raise ConfigError("no tag here; name a commit: make instructions ARGS='--against REV'")
    return done.stdout.strip()


def main(words: Sequence[str] | None = None) -> int:
    """Count here and there, and print the table; returns the exit code."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.instructions", description=__doc__)
    parser.add_argument("--against", metavar="REV", help="the earlier commit [the last tag]")
    options = parser.parse_args(words)
    if lack := missing():
        print(f"skipped: {lack}", file=sys.stderr)
        return 0
    revision = options.against or last_tag()
    there = built(revision)
    with TemporaryDirectory(prefix="swarmd-instructions-") as folder:
        before = count_in(there, Path(folder) / "before")
        now = count_in(ROOT, Path(folder) / "now")
    found = ratios(now, before)
    rows = [["what, instructions of a call in thousands", revision, "now", "ratio"]]
    for name, ratio in found.items():
        earlier = "-" if ratio is None else f"{before[name] / 1e3:.1f}"
        rows.append(
            [
                name,
                earlier,
                f"{now[name] / 1e3:.1f}",
                "-" if ratio is None else f"{ratio:.3f}",
            ]
        )
    print(markdown(rows))
    worse = over(found)
    print(f"\nover {100.0 * (MORE - 1.0):.0f} %: {'; '.join(worse) or 'none'}")
    return int(bool(worse))


if __name__ == "__main__":
    try:
        raise SystemExit(main())
    except SwarmError as error:
        raise SystemExit(f"error: {error}") from error
