"""One or two of seven robots have a fault: who names it, what touches, what the behaviour loses.

`python -m studies.faults [--seeds 20] [--jobs 2]`: twelve patterns, ten faults, and two controls,
the run without a fault and the run without these robots. Two robots have the fault in half of the
seeds. Prints the tables of docs/evidence/faults.md. The same command resumes.
"""

from __future__ import annotations

import re
from collections import defaultdict
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
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

ROBOTS, AT = 7, 2.0
FAULTY = ("tb3-04", "tb3-06")
"""The robots with a fault: the first one, or both."""
ORDINARY = ("", Reason.NO_REQUESTED_COMMAND, Reason.PROTECTION)
"""Reasons of a sound robot."""
SOUND, REMOVED = "none", "robot removed"
HEAD = (
    *("pattern", "outcome, mean of runs", "fault", "named after", "named in", "touches a run"),
    *("its fault", "others' fault", "outcome", "without fault", "without robot"),
)
HEAD_OF_TWO = (
    *("pattern", "fault of two robots", "touches a run", "their fault", "others' fault"),
    *("outcome", "one robot", "without fault", "without both"),
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
    "random_walk": Behaviour(
        "random_walk", "floor covered [m2]",
        _metric("covered_area"), {"duration": 60, "groups.tb3.count": ROBOTS},
    ),
    "circle_formation": Behaviour(
        "circle_formation", "off from the circle [m]",
        _metric("circle_offset"), {"duration": 60},
    ),
    "line_formation": Behaviour(
        "line_formation", "off from the line [m]", _metric("line_offset"), {"duration": 60}
    ),
    "vicsek_alignment": Behaviour(
        "vicsek_alignment", "polarisation",
        _metric("polarisation"), {"duration": 60, "groups.tb3.count": ROBOTS},
    ),
    "one_bit_aggregation": Behaviour(
        "one_bit_aggregation", "share in the largest cluster",
        _metric("largest_cluster_share"), {"duration": 120, "groups.tb3.count": ROBOTS},
    ),
    "follow_wall": Behaviour(
        "follow_wall", "late speed / limit",
        _metric("mean_speed_late_share"), {"duration": 90, "groups.tb3.count": ROBOTS},
    ),
    "majority_rule": Behaviour(
        "majority_rule", "time of consensus [s]",
        _metric("consensus_time"), {"duration": 60, "groups.tb3.count": ROBOTS},
    ),
}  # fmt: skip


class Task(Struct, frozen=True, order=True):
    """A run to do; `fault`: a key of FAULTS, or SOUND or REMOVED; `number`: robots that have it."""

    pattern: str
    fault: str
    seed: int
    number: int = 1

    @property
    def faulty(self) -> tuple[str, ...]:
        """The names of these robots."""
        return FAULTY[: self.number]


class Found(Struct, frozen=True, kw_only=True):
    """What a run gave: what the robot said first when, touches since the fault, and the outcome.

    `said`: by text without numbers, s since AT, by the first robot with the fault; of a run without
    a fault by all robots. `own`: touches at fault of the robots with the fault.
    """

    said: dict[str, float]
    touches: int
    own: int
    others: int
    outcome: float | None


Record: TypeAlias = keeper.Record[Task, Found]
"""A finished run."""


def scenario(task: Task) -> Scenario:
    """The scenario of a run."""
    behaviour = BEHAVIOURS[task.pattern]
    event: dict[str, Any] = {"at": AT, "fault": FAULTS.get(task.fault)}
    if task.fault.startswith("daemon"):
        event["for"] = 10.0
    controls = {SOUND: [], REMOVED: [{"at": AT, "remove": one} for one in task.faulty]}
    faults = [{**event, "robots": one} for one in task.faulty]
    changes = {**behaviour.changes, "events": controls.get(task.fault, faults)}
    return load_scenario(behaviour.scenario, changes)


def perform(task: Task) -> Traced[Found]:
    """Simulate and measure a run in this process."""
    trace = simulate_run(scenario(task), task.seed)
    since = [one for one in collisions(trace) if one.time >= AT]
    at_fault = [one.robot for one in since if one.is_fault]
    outcome = BEHAVIOURS[task.pattern].outcome(trace)
    own = sum(robot in task.faulty for robot in at_fault)
    found = Found(
        said=dict(sorted(_said(trace, is_control=task.fault == SOUND))),
        touches=len(since),
        own=own,
        others=len(at_fault) - own,
        outcome=None if np.isnan(outcome) else outcome,
    )
    return traced(found, trace)


def _said(trace: Trace, *, is_control: bool) -> Iterator[tuple[str, float]]:
    """The first time of each reason and of each text that the faulty robot, or any, logged."""
    found: defaultdict[str, list[float]] = defaultdict(list)
    for row, robot in enumerate(trace.ids):
        if trace.reason is not None and (is_control or robot == FAULTY[0]):
            for at, reason in zip(trace.t.tolist(), trace.reason[:, row].tolist(), strict=True):
                if reason not in ORDINARY:
                    found[reason].append(at - AT)
    for at, robot, text in trace.meta.get("said", ()):
        if is_control or robot == FAULTY[0]:
            found[re.sub(r"[\d.]+", "#", text)].append(at - AT)
    for text, times in found.items():
        later = [at for at in times if is_control or at >= 0.0]
        if later:
            yield text, round(min(later), 2)


def table(records: Sequence[Record]) -> str:
    """How often robots name each fault, the most seldom first; then a row for each cell."""
    by_cell = _cells(records)
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


def table_of_two(records: Sequence[Record], of_one: Sequence[Record]) -> str:
    """A row for each cell of `records`, in which two robots have the fault.

    `of_one`: the runs in which one robot has it, and those without a fault. Of these the seeds of
    `records` count.
    """
    seeds = {record.task.seed for record in records}
    by_cell = _cells(records)
    with_one = _cells(record for record in of_one if record.task.seed in seeds)
    rows: list[tuple[str, ...]] = [HEAD_OF_TWO]
    for pattern in BEHAVIOURS:
        for fault in FAULTS:
            runs = by_cell[pattern, fault]
            sums = [sum(getattr(one.found, key) for one in runs) for key in ("own", "others")]
            cells = (runs, with_one[pattern, fault], with_one[pattern, SOUND])
            outcomes = [[one.found.outcome for one in cell] for cell in cells]
            outcomes.append([one.found.outcome for one in by_cell[pattern, REMOVED]])
            touches = f"{np.mean([one.found.touches for one in runs]):.1f}"
            rows.append((pattern, fault, touches, *map(str, sums), *map(_mean, outcomes)))
    return f"Seeds: {len(seeds)}.\n\n{markdown(rows)}"


def _cells(records: Iterable[Record]) -> Mapping[tuple[str, str], list[Record]]:
    """The runs by pattern and fault."""
    by_cell: defaultdict[tuple[str, str], list[Record]] = defaultdict(list)
    for record in records:
        by_cell[record.task.pattern, record.task.fault].append(record)
    return by_cell


def _news(record: Record, usual: set[str]) -> list[float]:
    return [at for text, at in record.found.said.items() if text not in usual]


def _mean(values: Sequence[float | None]) -> str:
    known = [value for value in values if value is not None]
    return f"{np.mean(known):.3g}" if known else "-"


def main() -> None:
    """Do the runs, and print the table."""
    options = kept.chosen("faults", __doc__)
    tasks = [
        Task(pattern, fault, seed, number)
        for number, seeds in ((1, options.seeds), (2, (options.seeds + 1) // 2))
        for seed in range(seeds)
        for pattern in BEHAVIOURS
        for fault in (SOUND, REMOVED, *FAULTS)[number - 1 :]  # without a fault once
    ]
    records = keeper.records(perform, tasks, jobs=options.jobs)
    of_one = [record for record in records if record.task.number == 1]
    of_two = [record for record in records if record.task.number == 2]
    kept.print_parts({"faults": table(of_one), "faults_of_two": table_of_two(of_two, of_one)})


if __name__ == "__main__":
    restart_pinned()  # as in a night, so that runs have its bits
    main()
