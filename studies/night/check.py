"""Whether tables are current: `make night ARGS=--check`.

A table whose sources are those of its runs is current without a run. Else some of its kept runs are
done again and their bits compared (`kept_runs.drawn`). Bits say nothing of formulas: a table whose
study or metrics have changed otherwise than in comments has to be made again, and so has one of
which nobody knows: made with files of no commit, or of a commit that git does not know.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
from collections.abc import Sequence
from datetime import date
from enum import Enum
from pathlib import Path

import msgspec
from msgspec import Struct

from studies.behaviour.__main__ import built
from studies.night.jobs import Job, PatternJob
from studies.night.kept_runs import (
    Found,
    KeptRun,
    Made,
    drawn,
    read_made,
    read_runs,
    rules_in,
    write,
)
from studies.night.pages import write_origin, write_parts
from studies.night.sources import ROOT, changed_since, commit_of, head
from studies.outcomes.outcome import other_machine, software
from swarmd.core.errors import SwarmError
from swarmd.core.pin import pinned_environment
from swarmd.sim.experiments.cores import usable_cores
from swarmd.sim.experiments.run_list import VARIABLE as LIST
from swarmd.sim.experiments.run_store import OFF
from swarmd.sim.experiments.run_store import VARIABLE as STORE

PROGRAM = Path(__file__).with_name("again.py")
_FORMULAS = (
    *("studies/", "benchmarks/", "tests/", "sim/metrics/", "sim/experiments/statistics.py"),
    *("sim/experiments/outcomes.py", "sim/experiments/requirements.py"),
    *("sim/experiments/benchmark.py", "sim/experiments/compare.py"),
    *("sim/experiments/search_space.py", "sim/experiments/sequential.py"),
    *("sim/experiments/tune.py", "sim/experiments/tuned_values.py"),
)
_FORMULAS_OF_PATTERNS = ("/metrics.py", "/outcomes.yaml")
"""The files that compute tables of runs or choose runs, and that no run imports."""
_IN_BITS = (
    *("studies/keeper.py", "studies/kept.py"),
    *("studies/point_swarm.py", "tests/support/voting_sim.py"),
    *("studies/safety/plugins/", "studies/stand.py"),
)
"""Those of them that a run executes, or that compute nothing: bits tell whether they matter."""
_NAMED = 3  # files that a line names


NOT_CHECKED = "Not checked since."
"""The part of the page of a pattern whose table no check has looked at."""


class State(Enum):
    """What is known of a table."""

    NEVER_MADE = "never made"
    SAME_SOURCES = "current, of the same sources"
    CHECKED = "current"
    CHANGED = "changed"
    OTHER_FORMULAS = "its formulas have changed"
    UNKNOWN = "its formulas may have changed"
    NO_RUNS = "no kept runs"
    OPEN = "not checked"


CURRENT = (State.SAME_SOURCES, State.CHECKED)


class Look(Struct, frozen=True):
    """What is known of a table without doing a run.

    `changed`: the names of the sources that differ from those of the runs; None if git does not
    know their commit.
    """

    state: State
    text: str
    changed: tuple[str, ...] | None = ()


def look_at(job: Job) -> Look:
    """What is known of a job's table."""
    made = job.made
    if made is None:
        return Look(State.NEVER_MADE, "never made")
    digest = job.digest
    if made.made_with.get("digest") == digest:
        return Look(State.SAME_SOURCES, "current")
    if not made.is_same:
        return Look(State.CHANGED, made.checked or "its kept runs are of another table")
    for found, state in ((made.current, State.CHECKED), (made.changed, State.CHANGED)):
        if found is not None and found.digest == digest:
            return Look(state, found.text)
    commit = made.of_runs["commit"]
    if "," in commit:  # git does not know with which changes, and formulas may be among them
        return Look(State.UNKNOWN, f"made with files of no commit: {commit}", None)
    names = changed_since(commit, job.sources)
    if names is None:
        return Look(State.UNKNOWN, "of a commit that git does not know", None)
    since = f"{len(names)} files changed" if names else "made before its sources were known"
    if not read_runs(job.name):
        return Look(State.NO_RUNS, f"{since}; no run is kept", tuple(names))
    formulas = [name for name in names if _is_formula(name)]
    if formulas:
        text = f"{since}, with formulas: {_some(formulas)}"
        return Look(State.OTHER_FORMULAS, text, tuple(names))
    return Look(State.OPEN, f"{since}; --check looks at its runs", tuple(names))


def _is_formula(name: str) -> bool:
    is_one = name.startswith(_FORMULAS) or name.endswith(_FORMULAS_OF_PATTERNS)
    return is_one and not name.startswith(_IN_BITS)


def _some(names: Sequence[str]) -> str:
    more = f" and {len(names) - _NAMED} more" if len(names) > _NAMED else ""
    return f"{', '.join(names[:_NAMED])}{more}"


def check(job: Job, *, is_again: bool = False) -> Look:
    """Look at a table, and do some of its runs again if only they can tell; keeps what is found.

    `is_again`: runs are done also if the sources, or a check of these sources, have told.
    SwarmError if the commit of the runs cannot be built.
    """
    look = look_at(job)
    told = (State.SAME_SOURCES, State.CHECKED, State.CHANGED)
    made = read_made(job.name)
    runs = read_runs(job.name)
    if made is not None and look.state is State.SAME_SOURCES and made.changed is not None:
        made = msgspec.structs.replace(made, changed=None)  # what had changed it is taken back
        write(made, runs)
        tell_pages(job, made)
    if look.state is not State.OPEN and not (is_again and look.state in told):
        return look
    if made is None or not made.is_same or not runs:
        return look
    if lacking := job.lacks():
        return Look(State.OPEN, f"its runs are not done again: {lacking}", look.changed)
    digest = job.digest
    rules = rules_in(look.changed or ())
    draw = drawn(job.name, runs, head(), rules)
    differing = _differing(made, draw)
    found = Found(
        commit=commit_of(job.sources),
        day=date.today().isoformat(),
        digest=digest,
        drawn=len(draw),
        runs=len(runs),
        differing=len(differing),
    )
    name = "changed" if differing else "current"
    other = {"changed": "current", "current": "changed"}[name]
    kept = msgspec.structs.replace(made, **{name: found, other: None})
    write(kept, runs)
    tell_pages(job, kept)
    text = found.text
    if differing:
        text += (
            f" The first: {differing[0]}. Whether its printed intervals move is known once"
            f" `make night ARGS={job.name}` has made it again."
        )
    return Look(State.CHANGED if differing else State.CHECKED, text, look.changed)


def _differing(made: Made, draw: Sequence[KeptRun]) -> list[str]:
    """The runs of a draw that now differ, each as a text.

    On other libraries than those of the kept runs both sides are done here.
    """
    other = other_machine(made.of_runs, software())
    before = [{"bits": run.bits} for run in draw]
    if other is not None:
        commit = made.of_runs["commit"]
        if "," in commit:
            raise SwarmError(
                f"{made.table}: kept on other libraries ({other}), of {commit}, which cannot be"
                f" built; `make night ARGS={made.table}` makes it again"
            )
        print(f"{made.table}: other libraries: {other}", file=sys.stderr, flush=True)
        before = done_again(built(commit), draw)
    after = done_again(ROOT, draw)
    texts = []
    for run, was, now in zip(draw, before, after, strict=True):
        if was != now:
            what = {"error": "failed", "bits": "other bits"}
            now_is = "; ".join(f"{what[key]} {text}" for key, text in now.items())
            texts.append(f"{json.dumps(run.how)}: {now_is}")
    return texts


def done_again(
    checkout: Path, runs: Sequence[KeptRun], processes: int | None = None, python: str | None = None
) -> list[dict[str, str]]:
    """The bits of runs by the code of a checkout, or their errors, in their order.

    `processes`: that simulate at a time; None: as many as there are cores. `python`: the program
    that does them; None: that of this process.

    SwarmError if the program that does them fails.
    """
    environment = pinned_environment()
    environment |= {"PYTHONPATH": str(checkout), "OPENBLAS_NUM_THREADS": "1", STORE: OFF}
    environment.pop(LIST, None)
    done = subprocess.run(
        [python or sys.executable, "-P", str(PROGRAM), str(processes or usable_cores())],
        input="".join(f"{json.dumps(run.how)}\n" for run in runs),
        cwd=checkout,
        env={**environment, "PYTHONHASHSEED": os.environ.get("PYTHONHASHSEED", "0")},
        stdout=subprocess.PIPE,
        text=True,
        check=False,
    )
    if done.returncode:
        raise SwarmError(f"{checkout}: the runs could not be done again; see the lines above")
    return [json.loads(line) for line in done.stdout.splitlines()]


def tell_pages(job: Job, made: Made) -> None:
    """Write below each table of a job where it was made, and where it is current or changed."""
    if isinstance(job, PatternJob):
        write_parts({f"check_{job.name}": made.checked or NOT_CHECKED})
        return
    for part in made.parts:
        write_origin(part, made.origin)
