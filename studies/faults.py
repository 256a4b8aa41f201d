"""One of seven robots has a fault: who names it, what touches, what the behaviour loses.

`python -m studies.faults [--seeds 20] [--jobs 2]`: five patterns, ten faults, and two controls, the
run without a fault and the run without that robot. Prints the table of docs/evidence/faults.md. The
same command resumes.
"""

from __future__ import annotations

import re
from collections import defaultdict
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from types import MappingProxyType
from typing import Any, TypeAlias

import numpy as np
from msgspec import Struct

from benchmarks.table import markdown
from studies import keeper, kept
from studies.keeper import Traced, traced
from studies.outcomes.patterns.lloyd_coverage import cost
from studies.safety.judge import collisions
from swarmd.core.messages import Reason
from swarmd.core.pin import restart_pinned
from swarmd.patterns.flocking.metrics import parts
from swarmd.sim.lockstep.lockstep import simulate_run
from swarmd.sim.metrics.catalog import measure
from swarmd.sim.scenarios.scenario import Scenario
from swarmd.sim.scenarios.scenariofile import load_scenario
from swarmd.sim.trace import Trace

ROBOTS, FAULTY, AT = 7, "tb3-04", 2.0
ORDINARY = ("", Reason.NO_REQUESTED_COMMAND, Reason.PROTECTION)
"""Reasons of a sound robot."""
SOUND, REMOVED = "none", "robot removed"
HEAD = (
    *("pattern", "outcome, mean of runs", "fault", "named after", "named in", "touches a run"),
    *("its fault", "others' fault", "outcome", "without fault", "without robot"),
)
FAULTS: Mapping[str, Mapping[str, Any]] = MappingProxyType(
    {
        "scan frozen": {"scan": "frozen"},
        "scan blind, 90 deg ahead": {"scan": "blind_sector", "width_deg": 90},
        "scan mirrored": {"scan": "mirrored"},
        "scan 0.3 m too long": {"scan": "offset", "offset": 0.3},
        "odometry with the wrong sign": {"odometry": "wrong_sign"},
        "left wheel dead": {"base": "dead_wheel"},
        "base ignores zero": {"base": "ignores_zero"},
        "base 0.5 s late": {"base": "late", "seconds": 0.5},
        "radio mute": {"radio": "mute"},
        "daemon frozen for 10 s": {"process": "frozen"},
    }
)


@dataclass(frozen=True, slots=True)
class Behaviour:
    """A scenario with seven Burgers, and the outcome of its page as a number of a run."""

    scenario: str
    what: str
    outcome: Callable[[Trace], float]
    changes: Mapping[str, Any]


def _metric(name: str, factor: float = 1.0) -> Callable[[Trace], float]:
    return lambda trace: factor * float(measure(trace, [name])[name] or np.nan)


def _last_cost(trace: Trace) -> float:
    places = trace.pose[-1, :, :2]
    return cost(places[np.isfinite(places[:, 0])])


BEHAVIOURS = {
    "attraction": Behaviour(
        "paper_exp1_burger", "late distance to the centroid [m]",
        _metric("mean_distance_to_centroid_late"), {"duration": 60},
    ),
    "dispersion": Behaviour(
        "dispersion", "late distance to the nearest [m]",
        _metric("nearest_neighbor_median_late"), {"duration": 40, "groups.tb3.count": ROBOTS},
    ),
    "flocking": Behaviour("flocking", "parts of the flock", parts, {"duration": 60}),
    "lloyd_coverage": Behaviour(
        "lloyd_coverage", "cost at the end [m2]",
        _last_cost, {"duration": 80, "groups.tb3.count": ROBOTS},
    ),
    "foraging": Behaviour(
        "foraging", "items a minute",
        _metric("items_delivered", ROBOTS), {"duration": 120, "groups.tb3.count": ROBOTS},
    ),
}  # fmt: skip


class Task(Struct, frozen=True, order=True):
    """A run to do; `fault`: a key of FAULTS, or SOUND or REMOVED."""

    pattern: str
    fault: str
    seed: int


class Found(Struct, frozen=True, kw_only=True):
    """What a run gave: what the robot said first when, touches since the fault, and the outcome.

    `said`: by text without numbers, s since AT; of a run without a fault by all robots.
    """

    said: dict[str, float]
    touches: int
    own: int
    others: int
    outcome: float | None


Record: TypeAlias = keeper.Record[Task, Found]
"""A finished run."""


def scenario(pattern: str, fault: str) -> Scenario:
    """The scenario of a row."""
    behaviour = BEHAVIOURS[pattern]
    event: dict[str, Any] = {"at": AT, "fault": FAULTS.get(fault), "robots": FAULTY}
    if fault.startswith("daemon"):
        event["for"] = 10.0
    controls = {SOUND: [], REMOVED: [{"at": AT, "remove": FAULTY}]}
    changes = {**behaviour.changes, "events": controls.get(fault, [event])}
    return load_scenario(behaviour.scenario, changes)


def perform(task: Task) -> Traced[Found]:
    """Simulate and measure a run in this process."""
    trace = simulate_run(scenario(task.pattern, task.fault), task.seed)
    since = [one for one in collisions(trace) if one.time >= AT]
    at_fault = [one.robot for one in since if one.is_fault]
    outcome = BEHAVIOURS[task.pattern].outcome(trace)
    found = Found(
        said=dict(sorted(_said(trace, is_control=task.fault == SOUND))),
        touches=len(since),
        own=at_fault.count(FAULTY),
        others=len(at_fault) - at_fault.count(FAULTY),
        outcome=None if np.isnan(outcome) else outcome,
    )
    return traced(found, trace)


def _said(trace: Trace, *, is_control: bool) -> Iterator[tuple[str, float]]:
    """The first time of each reason and of each text that the faulty robot, or any, logged."""
    found: defaultdict[str, list[float]] = defaultdict(list)
    for row, robot in enumerate(trace.ids):
        if trace.reason is not None and (is_control or robot == FAULTY):
            for at, reason in zip(trace.t.tolist(), trace.reason[:, row].tolist(), strict=True):
                if reason not in ORDINARY:
                    found[reason].append(at - AT)
    for at, robot, text in trace.meta.get("said", ()):
        if is_control or robot == FAULTY:
            found[re.sub(r"[\d.]+", "#", text)].append(at - AT)
    for text, times in found.items():
        later = [at for at in times if is_control or at >= 0.0]
        if later:
            yield text, round(min(later), 2)


def table(records: Sequence[Record]) -> str:
    """How often robots name each fault, the most seldom first; then a row for each cell."""
    by_cell: defaultdict[tuple[str, str], list[Record]] = defaultdict(list)
    for record in records:
        by_cell[record.task.pattern, record.task.fault].append(record)
    rows: list[tuple[str, ...]] = [HEAD]
    named = dict.fromkeys(FAULTS, 0)
    for pattern in BEHAVIOURS:
        sound = by_cell[pattern, SOUND]
        usual = {text for record in sound for text in record.found.said}
        ends = [
            _mean([one.found.outcome for one in by_cell[pattern, key]]) for key in (SOUND, REMOVED)
        ]
        for fault in FAULTS:
            runs = by_cell[pattern, fault]
            times = [min(news) for one in runs if (news := _news(one, usual))]
            named[fault] += len(times)
            sums = [sum(getattr(one.found, key) for one in runs) for key in ("own", "others")]
            rows.append(
                (
                    *(pattern, BEHAVIOURS[pattern].what, fault),
                    f"{np.median(times):.1f} s" if times else "never",
                    f"{len(times)} of {len(runs)}",
                    f"{np.mean([one.found.touches for one in runs]):.1f}",
                    *map(str, sums),
                    _mean([one.found.outcome for one in runs]),
                    *ends,
                )
            )
    seldom_first = sorted(named, key=lambda fault: named[fault])
    runs_of = {fault: sum(one.task.fault == fault for one in records) for fault in FAULTS}
    counts = [f"{fault} {named[fault]} of {runs_of[fault]}" for fault in seldom_first]
    seeds = len({one.task.seed for one in records})
    first = f"Runs in which the robot named its fault: {'; '.join(counts)}. Seeds: {seeds}."
    return f"{first}\n\n{markdown(rows)}"


def _news(record: Record, usual: set[str]) -> list[float]:
    return [at for text, at in record.found.said.items() if text not in usual]


def _mean(values: Sequence[float | None]) -> str:
    known = [value for value in values if value is not None]
    return f"{np.mean(known):.3g}" if known else "-"


def main() -> None:
    """Do the runs, and print the table."""
    options = kept.chosen("faults", __doc__)
    tasks = [
        Task(pattern, fault, seed)
        for seed in range(options.seeds)
        for pattern in BEHAVIOURS
        for fault in (SOUND, REMOVED, *FAULTS)
    ]
    records = keeper.records(perform, tasks, jobs=options.jobs)
    kept.print_parts({"faults": table(records)})


if __name__ == "__main__":
    restart_pinned()  # as in a night, so that runs have its bits
    main()
