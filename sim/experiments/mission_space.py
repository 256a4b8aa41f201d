"""Missions as candidates of a tuning: which patterns run, in which order, and until when.

Source: AutoMoDe (G. Francesca et al., "AutoMoDe: A novel approach to the automatic design of
control software for robot swarms", Swarm Intelligence 8, 2014) combines given modules and
conditions with a bounded number of states. Here modules are patterns with their defaults, and the
controller is a mission: a sequence that repeats, or a switch, as in Maple (J. Kuckling et al.,
"Behavior trees as a control architecture in the automatic modular design of robot swarms", ANTS
2018). Missions have no transitions with a probability; times take their place.
"""

from __future__ import annotations

import hashlib
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import yaml

from swarmd.core.errors import ConfigError, unknown
from swarmd.core.files import whole_file
from swarmd.plugins import pattern_names
from swarmd.sim.experiments.search_space import SOURCE, parse_range
from swarmd.sim.scenarios.scenario import Scenario

if TYPE_CHECKING:
    from optuna.trial import FrozenTrial, Trial

MAX_STATES = 4
RANGES: Mapping[str, tuple[float, float]] = {"timeout": (2.0, 60.0), "nearer": (0.3, 1.5)}
"""Bounds of conditions that every robot can evaluate, in s and m."""
READING = "reading:"
_HEAD = "mission: Found by a tuning; runs {parts}\n"


class MissionSpace:
    """Missions of at most MAX_STATES states; their files are in `folder`, each in its own."""

    def __init__(
        self,
        groups: Sequence[str],
        modules: Sequence[str],
        ranges: Mapping[str, tuple[float, float]],
        folder: Path,
    ) -> None:
        """`ranges`: bounds by condition: timeout, nearer, reading:NAME."""
        self.groups, self.modules, self.ranges = tuple(groups), tuple(modules), dict(ranges)
        self.folder = folder
        self.conditions = [
            name
            for key in self.ranges
            for name in ([key] if key == "timeout" else [key, f"not {key}"])
        ]

    @property
    def text(self) -> list[str]:
        """The modules, and a line for each condition with its bounds."""
        bounds = [f"{key}={low:g}..{high:g}" for key, (low, high) in self.ranges.items()]
        return [f"mission of {','.join(self.modules)}, {MAX_STATES} states", *bounds]

    @property
    def present(self) -> dict[str, Any] | None:
        """None: the scenario's own pattern is no such mission."""
        return None

    def draw(self, trial: Trial) -> dict[str, Any]:
        """The values of a trial: kind, and part, condition and bound of each state."""
        states = trial.suggest_int("states", 1, MAX_STATES)
        kinds = ["sequence", "switch"]
        values: dict[str, Any] = {"kind": "part"}
        if states > 1:
            values["kind"] = trial.suggest_categorical("kind", kinds)
        for n in range(1, states + 1):
            values[f"part_{n}"] = trial.suggest_categorical(f"part_{n}", self.modules)
            if states > 1 and (n < states or values["kind"] == "sequence"):
                name = trial.suggest_categorical(f"condition_{n}", self.conditions)
                key = name.removeprefix("not ")
                low, high = self.ranges[key]
                bound = trial.suggest_float(f"{key}_{n}", low, high, log=key == "timeout")
                values[f"condition_{n}"] = name
                values[f"bound_{n}"] = min(max(float(f"{bound:.3g}"), low), high)
        return values

    def known_trial(self, values: Mapping[str, Any], loss: float) -> FrozenTrial | None:
        """None: there are no values of the scenario as it is."""
        return None

    def mission(self, values: Mapping[str, Any]) -> str:
        """The file of the mission with these values."""
        count = sum(name.startswith("part_") for name in values)
        used = [values[f"part_{n}"] for n in range(1, count + 1)]
        body: dict[str, Any] = {"parts": {name: {"pattern": name} for name in dict.fromkeys(used)}}
        if values["kind"] == "part":
            body["part"] = used[0]
        else:
            key = "until" if values["kind"] == "sequence" else "when"
            body[values["kind"]] = [
                {"part": name, "name": f"{name}_{n}", **_condition(values, n, key)}
                for n, name in enumerate(used, 1)
            ]
        if values["kind"] == "sequence":
            body["then"] = "repeat"
        text = yaml.safe_dump(body, sort_keys=False, default_flow_style=None, width=100)
        return _HEAD.format(parts=", ".join(dict.fromkeys(used))) + text

    def overrides(self, values: Mapping[str, Any]) -> dict[str, Any]:
        """Robots run the mission; its file is written, with a name that follows from it."""
        text = self.mission(values)
        name = f"m_{hashlib.sha256(text.encode()).hexdigest()[:10]}"
        place = (self.folder / name).absolute()
        if not (place / f"{name}.yaml").exists():
            place.mkdir(parents=True, exist_ok=True)
            with whole_file(place / f"{name}.yaml") as partial:
                partial.write_text(text, encoding="utf-8")
        patterns = {f"groups.{group}.pattern": name for group in self.groups}
        return {**patterns, "plugin_dir": str(place)}


def mission_space(
    scenario: Scenario, modules: Iterable[str], words: Iterable[str], folder: Path
) -> MissionSpace:
    """Missions of these patterns for the robots that begin with a pattern.

    `words` are bounds of conditions: `timeout=5..60`, `nearer=0.3..1`, `reading:light=0..100`.
    ConfigError if a pattern is unknown, or the scenario cannot run missions in their place.
    """
    modules = tuple(dict.fromkeys(name.strip() for name in modules if name.strip()))
    known = pattern_names(None)
    if not modules:
        raise ConfigError("--mission names no pattern; expected some, such as drive,random_walk")
    for name in modules:
        if name not in known:
            raise ConfigError(f"--mission: {unknown('pattern', name, known)}")
    if scenario.plugin_dir is not None:
        raise ConfigError(
            f"--mission and plugin_dir {scenario.plugin_dir}: missions of a tuning lie in a folder"
            " of their own; install its patterns as a package, or take another scenario"
        )
    groups = {
        name: group for name, group in scenario.effective["groups"].items() if group["pattern"]
    }
    if not groups:
        raise ConfigError(f"--mission: no group of scenario {scenario.name} begins with a pattern")
    for name, group in groups.items():
        if group["parameters"]:
            raise ConfigError(
                f"--mission: groups.{name}.parameters are those of {group['pattern']}; take a"
                " scenario without them"
            )
    ranges = dict(RANGES)
    for word in words:
        key = word.partition("=")[0]
        if key not in RANGES and not (key.startswith(READING) and key != READING):
            wanted = ", ".join((*RANGES, f"{READING}NAME"))
            raise ConfigError(f"{SOURCE} {key}: with --mission it is one of {wanted}")
        low, high = parse_range(word)
        if key in RANGES and low <= 0.0:
            raise ConfigError(f"{SOURCE} {word}: expected bounds above 0, such as {key}=0.5..1.5")
        for robot in (robot for name in groups for robot in scenario.groups[name]):
            if key not in RANGES and key not in scenario.robots[robot].provides:
                raise ConfigError(f"{SOURCE} {key}: {robot} has no such reading; leave it out")
        ranges[key] = (low, high)
    return MissionSpace(tuple(groups), modules, ranges, folder)


def _condition(values: Mapping[str, Any], n: int, key: str) -> dict[str, Any]:
    name = values.get(f"condition_{n}")
    if name is None:
        return {}
    bound = values[f"bound_{n}"]
    is_not = name.startswith("not ")
    plain = name.removeprefix("not ")
    if plain.startswith(READING):
        side = "below" if is_not else "above"
        return {key: {"reading": plain.removeprefix(READING), side: bound}}
    condition = {plain: bound}
    return {key: {"not": condition} if is_not else condition}
