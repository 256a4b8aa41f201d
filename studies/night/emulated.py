"""Kept runs on another processor: `make night ARGS="--check --processor SandyBridge"`.

The runs that a check draws are done by the code of this checkout, pinned, once on this processor
and once on one that qemu-user emulates, and their bits compared. Nothing is kept of it.
"""

from __future__ import annotations

import os
import shlex
import shutil
import subprocess
import sys
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path

from studies.night.check import done_again
from studies.night.jobs import Job
from studies.night.kept_runs import drawn, read_runs
from studies.night.sources import ROOT, head
from swarmd.core.errors import SwarmError

EMULATOR = "qemu-x86_64"
_CONTROL = "from swarmd.core.pin import digest_of_functions; print(digest_of_functions())"
_PINS = ("GLIBC_TUNABLES", "NPY_DISABLE_CPU_FEATURES", "OPENBLAS_CORETYPE")


@contextmanager
def python_on(processor: str) -> Iterator[str]:
    """A Python of this environment on an emulated processor, with all Python that it starts.

    processor: a name that `qemu-x86_64 -cpu help` lists. SwarmError if there is no such processor,
    or no emulator.
    """
    emulator = shutil.which(EMULATOR)
    if emulator is None:
        raise SwarmError(f"no {EMULATOR} on the PATH; on Debian: apt install qemu-user")
    here = Path(sys.executable)
    # Python finds its packages by the folder of its name, and starts other processes by that name.
    program = here.with_name(f"python-{processor}")
    # check=off: no warning of each feature that the emulator lacks
    words = (emulator, "-cpu", f"{processor},check=off", "-0", str(program), str(here.resolve()))
    program.write_text(f'#!/bin/sh\nexec {shlex.join(words)} "$@"\n')
    try:
        program.chmod(0o755)
        started = subprocess.run([program, "-c", ""], capture_output=True, text=True, check=False)
        if started.returncode:
            said = (started.stderr.strip().splitlines() or ["it does not start"])[-1]
            raise SwarmError(f"no emulated {processor}: {said}; see {EMULATOR} -cpu help")
        yield str(program)
    finally:
        program.unlink()


def check_on(processor: str, jobs: Sequence[Job]) -> int:
    """Print of each table with kept runs how many of the drawn ones are equal; 1 if one is not."""
    counts = {"equal": 0, "drawn": 0}
    with python_on(processor) as python:
        here, there = (_functions_of(program) for program in (sys.executable, python))
        what = "the same" if here == there else "other"
        print(f"control: without the pin the functions of {processor} give {what} bits", flush=True)
        for job in jobs:
            runs = read_runs(job.name)
            if not runs:
                continue
            if lacking := job.lacks():
                print(f"{job.name}: its runs are not done again: {lacking}", flush=True)
                continue
            draw = drawn(job.name, runs, head(), frozenset())
            pairs = zip(done_again(ROOT, draw), done_again(ROOT, draw, python=python), strict=True)
            equal = sum(_is_equal(*pair) for pair in pairs)
            print(f"{job.name}: {equal} of {len(draw)} runs are equal on {processor}", flush=True)
            counts["equal"] += equal
            counts["drawn"] += len(draw)
    print("{equal} of {drawn} runs are equal".format_map(counts))
    return int(counts["equal"] < counts["drawn"])


def _is_equal(one: Mapping[str, str], other: Mapping[str, str]) -> bool:
    """Whether two answers of `again.py` are of one run: a run that fails has no bits."""
    return "bits" in one and one == other


def _functions_of(python: str) -> str:
    """The digest of what functions give in a process that is not pinned."""
    environment = {name: value for name, value in os.environ.items() if name not in _PINS}
    done = subprocess.run(
        [python, "-c", _CONTROL],
        cwd=ROOT,
        env=environment,
        stdout=subprocess.PIPE,
        text=True,
        check=True,
    )
    return done.stdout.strip()
