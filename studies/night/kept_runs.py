"""The kept runs of a table: how each is done again, how its robots drove, and which rules acted.

`docs/evidence/runs/TABLE.jsonl` has a line about the table, and then a line for each run::

    {"table": "dispersion", "command": "python -m ...", "made_with": {...}, "current": {...}}
    {"scenario": "dispersion", "set": {"duration": 40}, "seed": 3, "bits": "...", "rules": [...]}
    {"run": "studies.faults:perform", "task": {...}, "bits": "...", "rules": [...]}

A run of `simulate` has its scenario, overrides and seed (`sim/experiments/run_list.py`). Another
run has a function of a study and its task, by which `studies.keeper.again` does it.
"""

from __future__ import annotations

import hashlib
import json
import math
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from types import MappingProxyType
from typing import Any

import msgspec
from msgspec import Struct

from studies.night.sources import ROOT
from swarmd.core.errors import SwarmError
from swarmd.core.files import write_whole
from swarmd.sim import behaviour

FOLDER = "docs/evidence/runs"
SHARE = 0.05
"""The share of a table's runs that a check does again."""
LEAST = 3
"""A check does so many runs of a table again, or all."""


class KeptRun(Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """A run: `scenario`, `set` and `seed`, or `run` and `task`, and what it gave."""

    scenario: str | dict[str, Any] = ""
    set: dict[str, Any] = {}
    seed: int = 0
    run: str = ""
    task: Any = None
    bits: str
    rules: tuple[str, ...] = ()

    @property
    def how(self) -> Mapping[str, Any]:
        """What does it again."""
        if self.run:
            return {"run": self.run, "task": self.task}
        return {"scenario": self.scenario, "set": self.set, "seed": self.seed}

    @property
    def key(self) -> str:
        """The text by which it is the same run."""
        return json.dumps(self.how, sort_keys=True)


class Made(Struct, frozen=True, kw_only=True):
    """What a table was made with, and where it was found current or changed.

    `made_with`: the software, and the keys `day`, `commit`, `digest` of the sources and
    `cpu_minutes`. `runs_with`: the same of the kept runs, if they were made later than the table.
    `is_same`: the kept runs gave the table that stands on the page.
    """

    table: str = ""
    command: str = ""
    made_with: dict[str, str] = {}
    parts: tuple[str, ...] = ()
    runs_with: dict[str, str] = {}
    is_same: bool = True
    current: Found | None = None
    changed: Found | None = None

    @property
    def origin(self) -> str:
        """The line of a page below the table."""
        made = "Made on {day} with commit {commit} by `{0}`.".format(
            self.command, **{"day": "?", "commit": "?", **self.made_with}
        )
        return " ".join(filter(None, (made, self.checked)))

    @property
    def checked(self) -> str:
        """What is known since the table was made, as a sentence; empty if nothing is."""
        if not self.is_same and self.runs_with:
            at = "{commit} ({day})".format_map(self.runs_with)
            return f"Changed at {at}: its runs give another table."
        found = self.current or self.changed
        return "" if found is None else found.text

    @property
    def of_runs(self) -> Mapping[str, str]:
        """The software, commit and sources of the kept runs."""
        return self.runs_with or self.made_with


class Found(Struct, frozen=True):
    """What a check found: `differing` of the `drawn` runs, of `runs` in all, had other bits.

    `digest`: of the sources at that time.
    """

    commit: str
    day: str
    digest: str
    drawn: int
    runs: int
    differing: int = 0

    @property
    def text(self) -> str:
        """The sentence of a page."""
        done = f"{self.drawn} of {self.runs} runs done again"
        if self.differing:
            return f"Changed at {self.commit} ({self.day}): {self.differing} of {done} differ."
        return f"Current at {self.commit} ({self.day}): {done}, with equal bits."


def file_of(table: str) -> Path:
    """The file of the kept runs of a table."""
    return ROOT / FOLDER / f"{table}.jsonl"


def read_made(table: str) -> Made | None:
    """What a table was made with; None without a file. SwarmError if it is no such file."""
    file = file_of(table)
    if not file.exists():
        return None
    with file.open("rb") as content:
        made: Made = _decoded(file, 1, content.readline(), Made)
        return made


def read_runs(table: str) -> list[KeptRun]:
    """The kept runs of a table, none without a file; SwarmError with the line of a fault."""
    file = file_of(table)
    if not file.exists():
        return []
    lines = file.read_bytes().splitlines()
    return [_decoded(file, number, line, KeptRun) for number, line in enumerate(lines[1:], 2)]


def write(made: Made, runs: Iterable[KeptRun]) -> None:
    """Write the file of a table, with its runs in the order of their keys."""
    head = {k: v for k, v in msgspec.to_builtins(made).items() if v or k == "is_same"}
    lines = [json.dumps(head)]
    lines += [
        json.dumps({**run.how, "bits": run.bits, "rules": run.rules})
        for run in sorted(runs, key=_order)
    ]
    file_of(made.table).parent.mkdir(parents=True, exist_ok=True)
    write_whole(file_of(made.table), "".join(f"{line}\n" for line in lines).encode())


def _order(run: KeptRun) -> tuple[str, int, str]:
    """By scenario or function, then by seed."""
    what = run.run or json.dumps([run.scenario, run.set], sort_keys=True)
    return what, run.seed, run.key


def listed(file: Path) -> list[KeptRun]:
    """The runs that a program has listed, each once; none without a file.

    A program that was killed and goes on lists runs twice: the last line counts. A last line that
    was cut off counts as not there. A path in this checkout becomes relative to it: a check may run
    in another one. SwarmError for another fault.
    """
    if not file.exists():
        return []
    content = file.read_bytes().replace(f'"{ROOT}/'.encode(), b'"')
    lines = content.split(b"\n")[:-1]
    runs = [_decoded(file, number, line, KeptRun) for number, line in enumerate(lines, 1)]
    return [*{run.key: run for run in runs}.values()]


def _decoded(file: Path, number: int, line: bytes, kind: type[Any]) -> Any:
    # The module json reads numbers that are not finite, too.
    try:
        return msgspec.convert(json.loads(line), kind)
    except ValueError as error:
        text = f"{file}:{number}: {error}; take it from git, or remove it"
        raise SwarmError(text) from error


def count_of_draw(runs: int) -> int:
    """How many runs a check does again: `count_of_draw(600) == 30`, `count_of_draw(20) == 3`."""
    return min(runs, max(LEAST, math.ceil(SHARE * runs)))


def drawn(table: str, runs: Sequence[KeptRun], commit: str, rules: frozenset[str]) -> list[KeptRun]:
    """The runs of a table that a check at `commit` does again; another commit draws others.

    `rules`: those of the files that have changed. Half of the draw, rounded up, is of runs in which
    one of these acted, as far as there are such runs.
    """

    def chance(run: KeptRun) -> bytes:
        return hashlib.sha256(f"{commit}\0{table}\0{run.key}".encode()).digest()

    count = count_of_draw(len(runs))
    order = sorted(runs, key=chance)
    near = [run for run in order if rules.intersection(run.rules)][: (count + 1) // 2]
    keys = {run.key for run in near}
    others = [run for run in order if run.key not in keys]
    return near + others[: count - len(near)]


RULE_FILES: Mapping[str, tuple[str, ...]] = MappingProxyType(
    {
        "barrier": ("swarmd/robot/protection/", "swarmd/robot/sensing/"),
        "potential_field": (
            "swarmd/robot/protection/modes.py",
            "swarmd/robot/sensing/potential_field.py",
        ),
        "protection": ("swarmd/robot/protection/",),
        behaviour.TOUCHING: (
            "swarmd/robot/protection/blind_zone.py",
            "swarmd/robot/protection/constraints.py",
            "swarmd/robot/protection/envelope.py",
            "swarmd/robot/protection/surfaces.py",
            "swarmd/robot/protection/touch_zone.py",
        ),
        behaviour.RECOVERY: (
            "swarmd/robot/steering/recovery.py",
            "swarmd/robot/steering/steering.py",
        ),
        behaviour.AVOIDANCE: (
            "swarmd/robot/steering/avoidance.py",
            "swarmd/robot/steering/steering.py",
            "swarmd/robot/steering/tracks.py",
            "swarmd/robot/steering/velocity_obstacles.py",
        ),
        behaviour.OPENING: (
            "swarmd/robot/protection/passage.py",
            "swarmd/robot/steering/openings.py",
            "swarmd/robot/steering/right_of_way.py",
            "swarmd/robot/steering/steering.py",
        ),
        behaviour.FENCE: ("swarmd/robot/protection/fence/",),
        behaviour.SLOWED: (
            "swarmd/robot/protection/assumption_monitor.py",
            "swarmd/robot/protection/barrier_assumptions.py",
        ),
        behaviour.CONTACT: ("sim/world/bodies.py", "sim/world/contacts.py", "sim/world/world.py"),
        **dict.fromkeys(
            ("no_scan", "invalid_scan", "stale_scan", "late_scan", "frozen_scan", "stale_odometry"),
            ("swarmd/robot/input_ages.py", "swarmd/robot/sensors.py"),
        ),
        "hazard": ("swarmd/robot/hazard_holds.py",),
        "no_pose": ("swarmd/robot/protection/fence/",),
    }
)
"""The files in which a rule of a run is written, and folders, with a slash; others have none."""


def rules_in(names: Iterable[str]) -> frozenset[str]:
    """The rules that are written in these files, by their paths in the checkout."""
    changed = tuple(names)
    return frozenset(
        rule
        for rule, files in RULE_FILES.items()
        if any(name.startswith(files) for name in changed)
    )
