"""Tries mutants of the code that decides motion: `make night ARGS=mutants`.

A mutant is the code with one operator, number or condition changed (by cosmic-ray). Tests of the
short lane run on each of them in a copy of the checkout; the kernels of a mutated unit run
interpreted, all others compiled. A mutant that no test kills must be in survivors.toml, as
equivalent with its reason, or open; else the exit code is 1. After a kill, or once the budget is
spent (exit code 2), the same command goes on.
"""

from __future__ import annotations

import argparse
import hashlib
import os
import shutil
import subprocess
import sys
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from functools import cache
from importlib.machinery import EXTENSION_SUFFIXES
from itertools import chain
from pathlib import Path
from queue import SimpleQueue
from typing import NamedTuple

import msgspec
from msgspec import Struct

from benchmarks.table import markdown
from studies import kept
from studies.mutants.judged import Judged, faults, read
from studies.mutants.mutant import Mutant, mutants_of
from studies.mutants.subjects import ROOT, Subject, subjects
from studies.mutants.zygote import UNCHANGED, Result, Trial
from swarmd.core.errors import SwarmError
from swarmd.core.files import lock_file
from swarmd.core.kernels import LIBRARIES, UNITS, VIEWS, source_of

BUILD = ROOT / "build" / "mutants"
MINUTES = 90.0
"""The budget in CPU-minutes."""
_SPENT = 2


class Tried(Struct, frozen=True):
    """A mutant that was tried; a line of the file of results."""

    digest: str
    """Of the module."""
    tests: str
    """The digest of the tests."""
    mutant: Mutant
    outcome: str
    """As of `Result`."""
    said: str
    seconds: float = 0.0
    """The CPU time; the first of a bench has its tests without a mutant, too."""

    @property
    def is_killed(self) -> bool:
        """Whether a test fails, hangs, or cannot even be collected."""
        return self.outcome != "passed"


class _Planned(NamedTuple):
    subject: Subject
    digest: str
    tests: str
    mutant: Mutant
    source: str


class Copy:
    """A copy of this checkout whose files are mutated, and its process."""

    def __init__(self, folder: Path) -> None:
        """Copy all files that git knows or would take, and the libraries of kernels."""
        shutil.rmtree(folder, ignore_errors=True)
        for name in (*_files(), *libraries()):
            source, target = ROOT / name, folder / name
            target.parent.mkdir(parents=True, exist_ok=True)
            if source.is_symlink() or source.exists():
                shutil.copy2(source, target, follow_symlinks=False)
        environment = {**os.environ, "OPENBLAS_NUM_THREADS": "1"}
        environment["PYTHONPATH"] = str(folder)
        environment.pop("PYTHONDONTWRITEBYTECODE", None)
        environment.pop("SWARMD_COMPILED", None)
        self._process = subprocess.Popen(
            [sys.executable, "-m", "studies.mutants.zygote", str(folder)],
            cwd=folder,
            env=environment,
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
        )

    def carry_out(self, trial: Trial) -> Result:
        """Run tests on a changed file; SwarmError if they fail without a change."""
        assert self._process.stdin is not None
        assert self._process.stdout is not None
        self._process.stdin.write(msgspec.json.encode(trial) + b"\n")
        self._process.stdin.flush()
        line = self._process.stdout.readline()
        if not line:
            raise SwarmError(f"the process of the copy has ended: {self._process.wait()}")
        result = msgspec.json.decode(line, type=Result)
        if result.outcome == "error" and result.said.startswith(UNCHANGED):
            raise SwarmError(f"{trial.path}: a test fails {result.said}")
        return result

    def close(self) -> None:
        """End the process."""
        assert self._process.stdin is not None
        self._process.stdin.close()
        self._process.wait()


def _files() -> Sequence[str]:
    words = ["git", "ls-files", "--cached", "--others", "--exclude-standard", "-z"]
    listed = subprocess.check_output(words, cwd=ROOT, text=True)
    return [name for name in listed.split("\0") if name]


def libraries() -> Sequence[str]:
    """The compiled kernels of this checkout, relative to the root.

    Those of a clone have the suffix of its Python, those of a wheel that of the stable ABI.
    """
    names = [name.replace(".", "/").replace("swarmd/sim/", "sim/") for name in (*LIBRARIES, VIEWS)]
    paths = [f"{name}{suffix}" for name in names for suffix in EXTENSION_SUFFIXES]
    return sorted(path for path in paths if (ROOT / path).exists())


def trial_of(plan: _Planned) -> Trial:
    """The trial of a mutant; subjects whose kernels are in one unit share a bench."""
    own = kernels_beside(plan.mutant.path)
    sharing = [
        (subject, path)
        for subject in subjects()
        for path in subject.paths
        if kernels_beside(path) == own
    ]
    files = dict.fromkeys(chain.from_iterable(one.tests + one.more for one, _ in sharing))
    return Trial(
        path=plan.mutant.path,
        source=plan.source,
        tests=plan.subject.tests + plan.subject.more,
        bench=tuple(files),
        changed=tuple(dict.fromkeys(path for _, path in sharing)),
        interpreted=own,
    )


@cache
def kernels_beside(path: str) -> tuple[str, ...]:
    """The kernels in the units of the one in a file; empty if the file is no kernel."""
    found = [kernels for kernels in UNITS.values() if path in map(source_of, kernels)]
    return tuple(dict.fromkeys(chain.from_iterable(found)))


def planned(chosen: Sequence[Subject]) -> Iterator[_Planned]:
    """The drawn mutants of subjects."""
    for subject in chosen:
        for path in subject.paths:
            digest = _digest([path])
            tests = _digest([*subject.tests, *subject.more])
            source = (ROOT / path).read_text()
            for mutant, mutated in mutants_of(path, source, subject.one_of):
                yield _Planned(subject, digest, tests, mutant, mutated)


def _digest(names: Sequence[str]) -> str:
    digest = hashlib.sha256()
    for name in names:
        digest.update((ROOT / name).read_bytes())
    return digest.hexdigest()[:16]


def results(
    file: Path, wanted: Sequence[_Planned], *, keeps_killed: bool = False
) -> dict[Mutant, Tried]:
    """The results of these mutants that were made from their module, as it is, and its tests.

    `keeps_killed`: a mutant that an earlier form of the tests killed counts as killed.
    """
    plans = {one.mutant: one for one in wanted}
    lines = file.read_bytes().splitlines() if file.exists() else []
    found = {}
    for line in lines:
        try:
            tried = msgspec.json.decode(line, type=Tried)
        except msgspec.DecodeError:  # cut by a kill
            continue
        plan = plans.get(tried.mutant)
        if plan is None or plan.digest != tried.digest:
            continue
        if plan.tests == tried.tests or (keeps_killed and tried.is_killed):
            found[tried.mutant] = tried
    return found


def run_all(
    wanted: Sequence[_Planned], jobs: int, budget: float, on_tried: Callable[[Tried], None]
) -> bool:
    """Try mutants until all are tried, or `budget` s of CPU time are spent; True if all are."""
    copies: SimpleQueue[Copy] = SimpleQueue()
    made = [Copy(BUILD / f"copy-{number}") for number in range(jobs)]
    for copy in made:
        copies.put(copy)
    left = [budget]

    def one(plan: _Planned) -> Tried | None:
        if left[0] <= 0.0:
            return None
        copy = copies.get()
        try:
            result = copy.carry_out(trial_of(plan))
            left[0] -= result.seconds
        finally:
            copies.put(copy)
        return Tried(
            plan.digest, plan.tests, plan.mutant, result.outcome, result.said, result.seconds
        )

    is_whole = True
    try:
        with ThreadPoolExecutor(jobs) as pool:
            for tried in pool.map(one, wanted):
                if tried is None:
                    is_whole = False
                else:
                    on_tried(tried)
    finally:
        for copy in made:
            copy.close()
    return is_whole


def table(
    wanted: Sequence[_Planned], tried: Mapping[Mutant, Tried], judged: Mapping[Mutant, Judged]
) -> str:
    """A row for each subject."""
    rows = [["code", "mutants", "killed", "of these by a time-out", "equivalent", "open"]]
    for subject in {one.name: one for one in subjects()}.values():
        own = [one.mutant for one in wanted if one.subject.name == subject.name]
        outcomes = [tried[mutant] for mutant in own if mutant in tried]
        if not outcomes:
            continue
        kinds = [
            judged[m].kind for m in own if m in tried and not tried[m].is_killed and m in judged
        ]
        share = "all" if subject.one_of == 1 else f"one of {subject.one_of}"
        cells = [
            len(outcomes),
            sum(one.is_killed for one in outcomes),
            sum(one.outcome == "timeout" for one in outcomes),
            kinds.count("equivalent"),
            kinds.count("open"),
        ]
        rows.append([f"`{subject.name}`, {share}", *map(str, cells)])
    return markdown(rows)


def main(words: Sequence[str] | None = None) -> int:
    """Try what was not tried yet, and print the table; returns the exit code."""
    parser = argparse.ArgumentParser(prog="python -m studies.mutants", description=__doc__)
    names = [*dict.fromkeys(subject.name for subject in subjects())]
    parser.add_argument("--only", nargs="+", choices=names, default=names, metavar="CODE")
    parser.add_argument("--minutes", type=float, default=MINUTES, help=f"of CPU [{MINUTES:g}]")
    parser.add_argument("--jobs", type=int, default=1, help="copies at a time [1]")
    parser.add_argument(
        "--keep-killed", action="store_true", help="count those that earlier tests killed"
    )
    options = parser.parse_args(words)
    judged = read()
    wanted = [*planned([one for one in subjects() if one.name in options.only])]
    BUILD.mkdir(parents=True, exist_ok=True)
    lock = os.open(BUILD / "lock", os.O_RDWR | os.O_CREAT)
    try:
        lock_file(lock, waits=False)
    except BlockingIOError as error:
        raise SwarmError(f"{BUILD}: another run tries mutants here; wait for its end") from error
    file = BUILD / "results.jsonl"
    tried = results(file, wanted, keeps_killed=options.keep_killed)
    rest = [one for one in wanted if one.mutant not in tried]
    benches = [*dict.fromkeys(kernels_beside(one.mutant.path) for one in wanted)]
    rest.sort(key=lambda one: benches.index(kernels_beside(one.mutant.path)))
    print(f"{len(wanted)} mutants, {len(rest)} to try", file=sys.stderr, flush=True)
    is_whole = True
    if rest:
        with file.open("ab") as kept_results:

            def note(one: Tried) -> None:
                tried[one.mutant] = one
                kept_results.write(msgspec.json.encode(one) + b"\n")
                kept_results.flush()
                if not one.is_killed:
                    print(f"survives: {one.mutant.name}", file=sys.stderr, flush=True)

            is_whole = run_all(rest, options.jobs, 60.0 * options.minutes, note)
    if not is_whole:
        left = len(wanted) - len(tried)
        print(f"the budget is spent, {left} are left: the same command goes on", file=sys.stderr)
        return _SPENT
    minutes = sum(one.seconds for one in tried.values()) / 60.0
    print(f"{len(tried)} mutants, tried in {minutes:.1f} CPU-minutes", file=sys.stderr)
    kept.print_parts({"mutants": table(wanted, tried, judged)})
    outcomes = {mutant: one.is_killed for mutant, one in tried.items()}
    some = {
        m: row for m, row in judged.items() if any(m.path in one.subject.paths for one in wanted)
    }
    found = faults(outcomes, some)
    print("\n".join(found), file=sys.stderr, flush=True)
    return 1 if found else 0


if __name__ == "__main__":
    try:
        raise SystemExit(main())
    except SwarmError as error:
        raise SystemExit(f"error: {error}") from error
