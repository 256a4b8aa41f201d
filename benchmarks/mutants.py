"""Which tests fail if one mechanism is taken out, or wrong: `python -m benchmarks.mutants`.

Each mutant is one textual change in a copy of the tree, in which its tests are run: those of
protection, but those that are `LEFT_OUT`, the outcomes of a pattern, or those of a driver's parts.
Prints the tables of docs/safety.md and docs/patterns; ends with 1 if a mutant survives, with 2 if
one does not apply.
"""

from __future__ import annotations

import argparse
import os
import re
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

from benchmarks.mutations import MUTANTS as OF_PROTECTION
from benchmarks.mutations import Mutant
from benchmarks.mutations_bases import MUTANTS as OF_BASES
from benchmarks.mutations_ros import MUTANTS as OF_ROS
from benchmarks.outcomes.catalog import MUTANTS as OF_PATTERNS
from swarmd.errors import SwarmError

ROOT = Path(__file__).resolve().parent.parent
COPIED = (
    *("tests/drivers", "tests/driving/test_stopper.py", "tests/driving/test_guarded.py"),
    *("swarmd", "patterns", "drivers", "sim", "config", "benchmarks", "pyproject.toml"),
    *("tests/protection", "tests/outcomes", "tests/patterns", "tests/kit/test_votes.py"),
    "tests/kit/test_voting.py",
)
MUTANTS = (*OF_PROTECTION, *OF_PATTERNS, *OF_ROS, *OF_BASES)
# Whole rides and swarms take longest, and show least of which mechanism it was.
LEFT_OUT = ("test_directed_rides.py", "test_directed_swarm.py")
_FAILED = re.compile(r"^(?:FAILED|ERROR) (\S+?)::(?:\w+::)?(\w+)", re.MULTILINE)


def copy_tree(tree: Path) -> None:
    """What the tests of mutants need, links as links."""
    for name in COPIED:
        source, target = ROOT / name, tree / name
        target.parent.mkdir(parents=True, exist_ok=True)
        if source.is_dir():
            ignored = shutil.ignore_patterns("__pycache__")
            shutil.copytree(source, target, symlinks=True, ignore=ignored)
        else:
            shutil.copy2(source, target)


def failing(tree: Path, tests: Sequence[str]) -> tuple[int, list[str]]:
    """The exit code of these tests in a tree, and the names of those that failed."""
    command = [sys.executable, "-m", "pytest", *tests, "-q", "--tb=no"]
    command += ["-p", "no:cacheprovider", "--timeout=900"]  # what is wrong may take long to end
    command += ["--hypothesis-profile=mutants"] * ("tests/protection" in tests)
    command += [f"--ignore=tests/protection/{name}" for name in LEFT_OUT]
    environment = {**os.environ, "PYTHONPATH": str(tree), "PYTHONDONTWRITEBYTECODE": "1"}
    done = subprocess.run(
        command, cwd=tree, env=environment, capture_output=True, text=True, check=False
    )
    names = dict.fromkeys(name for _, name in _FAILED.findall(done.stdout))
    if done.returncode not in (0, 1):
        raise SwarmError(f"pytest ended with {done.returncode}:\n{done.stdout}{done.stderr}")
    return done.returncode, list(names)


def try_out(mutant: Mutant | None, tests: Sequence[str]) -> list[str]:
    """The tests that fail with a mutant, or with none, in a copy of its own."""
    with tempfile.TemporaryDirectory() as folder:
        tree = Path(folder)
        copy_tree(tree)
        if mutant is not None:
            mutant.apply(tree)
        return failing(tree, tests)[1]


def row(mutant: Mutant, failed: Sequence[str]) -> str:
    """A line of the table."""
    first = f"`{failed[0]}`" if failed else "**none**"
    return f"| {mutant.mechanism} | {mutant.change} | {len(failed)} | {first} |"


def check() -> None:
    """SwarmError unless each mutant's text is found in the sources once."""
    with tempfile.TemporaryDirectory() as folder:
        for number, mutant in enumerate(MUTANTS):
            tree = Path(folder) / str(number)
            (tree / mutant.path).parent.mkdir(parents=True)
            shutil.copy2(ROOT / mutant.path, tree / mutant.path)
            mutant.apply(tree)


def chosen(words: Sequence[str]) -> list[Mutant]:
    """The mutants whose mechanism or tests hold one of the words; all without any."""
    return [
        m for m in MUTANTS if not words or any(word in f"{m.mechanism} {m.tests}" for word in words)
    ]


def main(arguments: Sequence[str] | None = None) -> None:
    parser = argparse.ArgumentParser(prog="python -m benchmarks.mutants", description=__doc__)
    parser.add_argument("words", nargs="*", metavar="WORD", help="of mechanisms; default: all")
    parser.add_argument("--jobs", type=int, default=os.cpu_count() or 1, help="at a time")
    options = parser.parse_args(arguments)
    check()
    some: list[Mutant | None] = [None, *chosen(options.words)]
    tests = [[mutant.tests] for mutant in some if mutant is not None]
    survivors = 0
    with ThreadPoolExecutor(options.jobs) as pool:
        found = pool.map(try_out, some, [sorted({name for (name,) in tests}), *tests])
        whole = next(found)
        if whole:
            pool.shutdown(cancel_futures=True)
            raise SwarmError(f"{len(whole)} tests fail without any mutant, as {whole[0]}")
        print("| mechanism | taken out by this change | tests that fail | the first of them |")
        print("|---|---|---|---|")
        for mutant, failed in zip(some[1:], found, strict=True):
            assert mutant is not None
            print(row(mutant, failed), flush=True)
            survivors += not failed
    if survivors:
        raise SystemExit(1)


if __name__ == "__main__":
    try:
        main()
    except SwarmError as error:
        print(f"error: {error}", file=sys.stderr)
        raise SystemExit(2) from error
