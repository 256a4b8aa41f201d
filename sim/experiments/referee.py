"""A controller of others through the tasks of the benchmark suite, beside robots that stand.

Each case of a task is an experiment of its own, which `exp rerun` repeats: the controller, robots
that stand, and the controller while one robot has a fault. A verdict compares runs of the same
seeds, with Holm's correction for all verdicts of the referee together.
"""

from __future__ import annotations

import hashlib
import os
import re
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from types import MappingProxyType
from typing import Any, NamedTuple

from swarmd.core.errors import ConfigError, unknown
from swarmd.core.files import read_regular, user_path
from swarmd.plugins import PATTERN_FILE, is_pattern_path, pattern_at
from swarmd.ros2_nodes.launch_file import is_launch_text
from swarmd.sim.experiments.benchmark import plan_of_task, task_of
from swarmd.sim.experiments.compare import Difference, Side, compare, corrected
from swarmd.sim.experiments.plan import Plan
from swarmd.sim.experiments.requirements import Verdict
from swarmd.sim.experiments.results import Results
from swarmd.sim.metrics.metric import Metric
from swarmd.sim.scenarios.scenariofile import load_scenario

SOUND = "sound"
"""The case of the controller without a fault."""
STAND = "stand"
"""The control: the pattern `drive` with all speeds 0."""
_STILL = MappingProxyType({"speed": 0.0, "turn": 0.0, "lateral": 0.0, "recovery": False})
FAULTS: Mapping[str, Mapping[str, Any]] = MappingProxyType(
    {
        "scan_frozen": {"scan": "frozen"},
        "dead_wheel": {"base": "dead_wheel"},
        "radio_mute": {"radio": "mute"},
    }
)
"""Of one robot, from AT on: a sensor, the base and the network."""
AT = 2.0
"""s after the start of a run; a tenth of a run of less than 20 s."""
ALPHA = 0.05
NODES = "ros2_nodes"
POLICIES = (".onnx", ".npz")
BETTER = "better"
WORSE = "worse"
OPEN = "open"
SAME = "same bits"
"""The verdict of a case whose runs are those of its control, to the last bit."""
_UNTIL = re.compile(r"\s*(\w+)\s*(>=|<=|>|<)\s*(\S+)\s*")
_WORDS = {">=": "at_least", "<=": "at_most", ">": "above", "<": "below"}
"""Comparisons in the names of folders."""


class Controller(NamedTuple):
    """What is refereed.

    - `pattern`: a name, or the path of a pattern or mission.
    - `values`: overrides of each task by dotted key, such as the launch file of nodes.
    - `policy`: a file with a network, of which a pattern is to be made first; None for others.
    - `files`: its own file or folder; None for a shipped pattern.
    """

    pattern: str
    plugin_dir: Path | None = None
    values: Mapping[str, Any] = MappingProxyType({})
    policy: Path | None = None
    files: Path | None = None


class Case(NamedTuple):
    """The runs of a task in one case."""

    task: str
    case: str
    plan: Plan
    metric: Metric


def controller_of(text: str) -> Controller:
    """The controller that a name or a path means: a pattern, a mission, nodes of ROS 2, a policy.

    A folder holds one: a `pattern.py`, a launch file, a network, or a pattern's .py. ConfigError
    for a folder with none or several.
    """
    path = Path(os.path.abspath(user_path(text)))
    if not path.exists() and not is_pattern_path(text) and path.suffix not in POLICIES:
        return Controller(text)
    if path.is_dir() and not (path / PATTERN_FILE).is_file():
        path = _only_one(path, text)
    if path.suffix in POLICIES:
        if not path.is_file():
            raise ConfigError(f"{text}: there is no such file")
        return Controller(path.stem, policy=path)
    if path.suffix == ".yaml" and path.is_file() and is_launch_text(read_regular(path)):
        values = {f"parameters.{NODES}.launch": str(path)}
        return Controller(NODES, path.parent, values, files=path.parent)
    place = pattern_at(str(path))
    return Controller(place.name, place.folder, files=path)


def _only_one(folder: Path, text: str) -> Path:
    """The one controller in a folder."""
    files = [one for one in sorted(folder.iterdir()) if one.is_file()]
    kinds = (
        [one for one in files if one.suffix == ".yaml" and is_launch_text(read_regular(one))],
        [one for one in files if one.suffix in POLICIES],
        [one for one in files if one.suffix == ".py" and not one.name.startswith("test_")],
    )
    for found in kinds:
        if len(found) == 1:
            return found[0]
        if found:
            names = ", ".join(one.name for one in found)
            raise ConfigError(f"{text} has {names}; name the file of the controller")
    raise ConfigError(
        f"{text} has no controller; expected {PATTERN_FILE}, a launch file of ROS 2 nodes (a .yaml"
        " with `nodes:`), a network (.onnx, .npz), or a pattern's .py"
    )


def digest_of(controller: Controller, without: Path) -> str:
    """The digest of the files of a controller: 12 hexadecimal digits; empty for a shipped one.

    `without`: a folder that does not count, such as that of the runs.
    """
    root = controller.policy or controller.files
    if root is None:
        return ""
    if root.is_file():
        return hashlib.sha256(root.read_bytes()).hexdigest()[:12]
    found = hashlib.sha256()
    for path in sorted(root.rglob("*")):
        name = path.relative_to(root)
        is_apart = path.is_relative_to(without) or any(part[0] in "._" for part in name.parts[:-1])
        if path.suffix in _DECIDING and not is_apart and path.is_file():
            found.update(f"{name.as_posix()}\0".encode())
            found.update(hashlib.sha256(path.read_bytes()).digest())
    return found.hexdigest()[:12]


_DECIDING = (".py", ".yaml", ".msg", ".srv")


def cases_of(
    scenario: str,
    seeds: Sequence[int],
    controller: Controller,
    faults: Iterable[str] = tuple(FAULTS),
    values: Mapping[str, Any] | None = None,
    on_misfit: Callable[[str], object] = str,
) -> list[Case]:
    """The cases of a task; none if its robots lack what the controller needs.

    `values`: overrides by dotted key. ConfigError for an unknown fault, and as `plan_of_task`.
    """
    own = {**(values or {}), **controller.values}
    made = plan_of_task(
        scenario, seeds, [controller.pattern], controller.plugin_dir, on_misfit, own
    )
    if made is None or not made[0].variants:
        return []
    plan, metric = made
    task = task_of(plan)
    cases = [Case(task, SOUND, plan, metric)]
    robot = _first_robot(scenario, own | {"pattern": controller.pattern}, controller)
    present = list(plan.variants[0].effective.get("events") or ())
    for fault in faults:
        if fault not in FAULTS:
            raise ConfigError(unknown("fault", fault, FAULTS))
        at = min(AT, 0.1 * float(plan.variants[0].effective["duration"]))
        event = {"at": at, "fault": dict(FAULTS[fault]), "robots": robot}
        changed = plan_of_task(
            scenario,
            seeds,
            [controller.pattern],
            controller.plugin_dir,
            on_misfit,
            own | {"events": [*present, event]},
        )
        if changed is not None:
            cases.append(Case(task, fault, changed[0], metric))
    still = {**(values or {}), **{f"patterns.drive.{key}": value for key, value in _STILL.items()}}
    standing = plan_of_task(scenario, seeds, ["drive"], None, on_misfit, still)
    if standing is not None:
        cases.append(Case(task, STAND, standing[0], metric))
    return cases


def _first_robot(scenario: str, values: Mapping[str, Any], controller: Controller) -> str:
    """The first robot that runs the controller."""
    folder = {} if controller.plugin_dir is None else {"plugin_dir": str(controller.plugin_dir)}
    loaded = load_scenario(scenario, {**values, **folder})
    for event in loaded.events:
        if event.pattern == controller.pattern and event.robots:
            return str(event.robots[0])
    raise ConfigError(f"{scenario}: no robot runs {controller.pattern}")


@dataclass(frozen=True, slots=True)
class Finding:
    """A case of a task beside its control: the stand for SOUND, else SOUND.

    - `verdict`: BETTER, WORSE, SAME, or OPEN if the runs do not tell them apart; of two values that
      are better when less, the smaller one is better.
    - `bits`: a digest of the bits of all runs.
    """

    task: str
    case: str
    against: str
    unit: str
    difference: Difference | None
    verdict: str
    runs: int
    failed: int
    contacts: int
    bits: str


def findings_of(found: Sequence[tuple[Case, Results]]) -> list[Finding]:
    """The findings of all cases, in their order."""
    by_case = {(case.task, case.case): (case, results) for case, results in found}
    pairs: list[tuple[Case, Results, str]] = []
    differences: list[Difference | None] = []
    for case, results in found:
        against = "" if case.case == STAND else STAND if case.case == SOUND else SOUND
        other = by_case.get((case.task, against))
        pairs.append((case, results, against if other is not None else ""))
        difference = None
        if other is not None and results.rows and other[1].rows:
            difference = compare(_side(*other), _side(case, results), [case.metric])[0]
        differences.append(difference)
    adjusted = iter(corrected([one for one in differences if one is not None]))
    made = [
        _finding(case, results, against, None if one is None else next(adjusted))
        for (case, results, against), one in zip(pairs, differences, strict=True)
    ]
    bits = {(one.task, one.case): one.bits for one in made}
    return [
        replace(one, verdict=SAME)
        if one.runs and one.bits == bits.get((one.task, one.against))
        else one
        for one in made
    ]


def _side(case: Case, results: Results) -> Side:
    return Side(case.case, results, results.variants[0])


def _finding(case: Case, results: Results, against: str, difference: Difference | None) -> Finding:
    contacts = sum(int(row.get(name) or 0) for row in results.rows for name in _CONTACTS)
    return Finding(
        task=case.task,
        case=case.case,
        against=against,
        unit=case.metric.unit,
        difference=difference,
        verdict=verdict_of(difference, case.metric),
        runs=len(results.rows),
        failed=len(results.failures) + len(results.pattern_faults),
        contacts=contacts,
        bits=bits_of(row["bits"] for row in results.rows),
    )


_CONTACTS = ("robot_contacts", "arena_contacts")


def verdict_of(difference: Difference | None, metric: Metric) -> str:
    """The verdict of a difference whose p is corrected; OPEN if neither direction is better."""
    if difference is None or difference.difference is None or difference.p_holm is None:
        return OPEN
    if difference.p_holm >= ALPHA or metric.better is None:
        return OPEN
    is_more = difference.difference > 0.0
    return BETTER if is_more == (metric.better == "more") else WORSE


def bits_of(bits: Iterable[str]) -> str:
    """A digest of the bits of runs, 12 hexadecimal digits."""
    return hashlib.sha256("\n".join(bits).encode()).hexdigest()[:12]


@dataclass(frozen=True, slots=True)
class Until:
    """A requirement on the mean of a task's metric; `task >= value` as the user wrote it."""

    text: str
    task: str
    comparison: str
    value: str

    def requirement(self, metric: Metric) -> str:
        """The requirement with the name of the metric."""
        return f"{metric.name} {self.comparison} {self.value}"

    @property
    def folder(self) -> str:
        """The name of the folder of its runs, below that of the task."""
        return f"until_{_WORDS[self.comparison]}_{self.value}"


def parse_until(text: str) -> Until:
    """The parts of `TASK >= VALUE`; ConfigError for another text."""
    match = _UNTIL.fullmatch(text)
    if match is None:
        raise ConfigError(f"--until {text!r}: expected 'TASK >= VALUE', such as 'doorway >= 0.3'")
    return Until(text, *match.groups())


class Decision(NamedTuple):
    """The answer to an `Until`, and the number of seeds that it took."""

    until: Until
    verdict: Verdict
    runs: int
    bits: str
