"""Missions as candidates of a tuning: the search space of their patterns, conditions and numbers.

Source: AutoMoDe (G. Francesca et al., "AutoMoDe: A novel approach to the automatic design of
control software for robot swarms", Swarm Intelligence 8, 2014; Chocolate: 9, 2015) searches
probabilistic finite state machines of given modules and conditions, with a bounded number of
states. Here a module is a pattern with default parameters, and a controller is a mission of one of
three kinds: a sequence with transitions, which is a probabilistic finite state machine; a sequence
that repeats; or a switch, which runs the first pattern whose condition holds, as in Maple
(J. Kuckling et al., "Behavior trees as a control architecture in the automatic modular design of
robot swarms", ANTS 2018).

`MissionSpace` searches structure and numbers. `MissionFileSpace` searches the numbers of a given
mission alone.
"""

from __future__ import annotations

import hashlib
from abc import ABC, abstractmethod
from collections.abc import Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING, Any

from swarmd.core.errors import ConfigError, unknown
from swarmd.core.files import whole_file
from swarmd.kit.factory import Find
from swarmd.mission.mission import mission_class
from swarmd.mission.schema import MissionFile
from swarmd.pattern_host.loader import PatternLoader
from swarmd.plugins import is_same_file, pattern_names
from swarmd.settings.yamlfile import brief, read, shown, text_of
from swarmd.sim.experiments.search_space import (
    SOURCE,
    Parameter,
    ParameterSpace,
    check_keys,
    file_parameter,
    parse_range,
    patterns_of,
)
from swarmd.sim.scenarios.overrides import nested
from swarmd.sim.scenarios.scenario import Scenario

if TYPE_CHECKING:
    from optuna.trial import FrozenTrial, Trial

MAX_STATES, MAX_TRANSITIONS = 4, 2
"""The most states of a mission, and the most transitions of a state."""
PROBABILITY = "probability"
NEIGHBORS = "neighbors"
READING = "reading:"
RANGES: Mapping[str, tuple[float, float]] = {
    "timeout": (2.0, 60.0),
    "nearer": (0.3, 1.5),
    PROBABILITY: (0.01, 1.0),
}
"""Bounds of conditions that every robot can evaluate: `timeout` in s, `nearer` in m, and the
probability per second."""
_LOG = ("timeout", PROBABILITY)  # bounds that are searched by their logarithm
SUFFIX = ".yaml"
_SPAN = "{:g}..{:g}".format(*RANGES[PROBABILITY])
_HEAD = "mission: Found by a tuning; runs {parts}\n"


class Missions(ABC):
    """A search space of missions; each candidate is a file in a folder of its own in `folder`."""

    groups: tuple[str, ...]
    """The groups of the scenario whose robots run the mission."""
    folder: Path

    @abstractmethod
    def mission(self, values: Mapping[str, Any]) -> str:
        """The file of the mission with these values."""

    def overrides(self, values: Mapping[str, Any]) -> dict[str, Any]:
        """The overrides by which the groups run the mission; writes the mission's file.

        The file's name is a digest of its text.
        """
        text = self.mission(values)
        name = f"m_{hashlib.sha256(text.encode()).hexdigest()[:10]}"
        place = (self.folder / name).absolute()
        if not (place / f"{name}.yaml").exists():
            place.mkdir(parents=True, exist_ok=True)
            with whole_file(place / f"{name}.yaml") as partial:
                partial.write_text(text, encoding="utf-8")
        patterns = {f"groups.{group}.pattern": name for group in self.groups}
        return {**patterns, "plugin_dir": str(place)}


class MissionSpace(Missions):
    """Missions of at most MAX_STATES states, composed of given patterns and conditions."""

    def __init__(
        self,
        groups: Sequence[str],
        modules: Sequence[str],
        ranges: Mapping[str, tuple[float, float]],
        folder: Path,
    ) -> None:
        """`modules`: names of patterns. `ranges`: by condition, the least and greatest bound.

        Conditions: timeout, nearer, probability, neighbors, reading:NAME. A candidate has a bound
        within the range, such as 0.5 m of `nearer`. Missions are written into `folder`.
        """
        self.groups = tuple(groups)
        self.modules = tuple(modules)
        self.ranges = dict(ranges)
        self.folder = folder
        self.conditions: list[str] = []
        for key in self.ranges:  # a timeout or a probability is not negated
            self.conditions += [key] if key in _LOG else [key, f"not {key}"]
        # The conditions of a switch, which is evaluated anew at each step: no random event.
        self.lasting = [name for name in self.conditions if name != PROBABILITY]

    @property
    def text(self) -> list[str]:
        """The modules, and a line for each condition with its bounds."""
        bounds = [f"{key}={low:g}..{high:g}" for key, (low, high) in self.ranges.items()]
        return [f"mission of {','.join(self.modules)}, {MAX_STATES} states", *bounds]

    @property
    def present(self) -> dict[str, Any] | None:
        """None: the scenario's own pattern is no mission of this space."""
        return None

    def draw(self, trial: Trial) -> dict[str, Any]:
        """Draw a candidate: the kind of mission, and for each state its pattern and conditions.

        Values of states that no chain of transitions reaches from state 1 are left out.
        """
        states = trial.suggest_int("states", 1, MAX_STATES)
        values: dict[str, Any] = {"kind": "part"}
        if states > 1:
            kinds = ["sequence", "switch", "machine"]
            values["kind"] = trial.suggest_categorical("kind", kinds)
        is_machine = values["kind"] == "machine"
        for n in range(1, states + 1):
            values[f"part_{n}"] = trial.suggest_categorical(f"part_{n}", self.modules)
            if is_machine:
                self._draw_transitions(trial, n, states, values)
            elif values["kind"] == "sequence":
                self._draw_condition(trial, f"{n}", self.conditions, values)
            elif n < states:  # the last pattern of a switch runs if no condition holds
                self._draw_condition(trial, f"{n}", self.lasting, values)
        if not is_machine:
            return values
        reached = _reached(values, states)
        return {key: value for key, value in values.items() if _state(key) in (0, *reached)}

    def known_trial(self, values: Mapping[str, Any], loss: float) -> FrozenTrial | None:
        """None: the unchanged scenario has no values in this space."""
        return None

    def mission(self, values: Mapping[str, Any]) -> str:
        """The file of the mission with these values."""
        kind = values["kind"]
        states = [n for n in range(1, MAX_STATES + 1) if f"part_{n}" in values]
        used = [values[f"part_{n}"] for n in states]
        names = {n: f"{part}_{n}" for n, part in zip(states, used, strict=True)}
        body: dict[str, Any] = {"parts": {name: {"pattern": name} for name in dict.fromkeys(used)}}
        if kind == "part":
            body["part"] = used[0]
        elif kind == "machine":
            body["sequence"] = [
                {"part": part, "name": names[n], "transitions": _transitions(values, n, names)}
                for n, part in zip(states, used, strict=True)
            ]
            body["then"] = "stay"
        else:
            key = "until" if kind == "sequence" else "when"
            body[kind] = [
                {"part": part, "name": names[n], **_keyed(key, _condition(values, f"{n}"))}
                for n, part in zip(states, used, strict=True)
            ]
        if kind == "sequence":
            body["then"] = "repeat"
        return _HEAD.format(parts=", ".join(dict.fromkeys(used))) + _yaml(body)

    def _draw_transitions(self, trial: Trial, n: int, states: int, values: dict[str, Any]) -> None:
        """Draw up to MAX_TRANSITIONS transitions of state n, each to a different other state.

        Adds to `values`, for transition k: `target_n_k`, `condition_n_k` and `bound_n_k`. For a
        condition that may hold for long (neither a timeout nor a probability), also `chance_n_k`:
        the probability per second of the transition while the condition holds.
        """
        for k in range(1, min(MAX_TRANSITIONS, states - 1) + 1):
            place = f"{n}_{k}"
            # A target is drawn as a number of states after n, in a circle. 0 steps: no transition,
            # which the first transition of a state may not be.
            least = 1 if k == 1 else 0
            steps = trial.suggest_int(f"target_{place}_of_{states}", least, states - 1)
            target = (n - 1 + steps) % states + 1
            known = [values.get(f"target_{n}_{before}") for before in range(1, k)]
            if target == n or target in known:
                continue
            values[f"target_{place}"] = target
            self._draw_condition(trial, place, self.conditions, values)
            if values[f"condition_{place}"] not in _LOG:
                values[f"chance_{place}"] = self._bound(trial, PROBABILITY, f"chance_{place}")

    def _draw_condition(
        self, trial: Trial, place: str, names: Sequence[str], values: dict[str, Any]
    ) -> None:
        """Add `condition_PLACE`, one of `names`, and `bound_PLACE` to `values`."""
        kind = "condition" if names is self.conditions else "when"
        name = values[f"condition_{place}"] = trial.suggest_categorical(f"{kind}_{place}", names)
        key = name.removeprefix("not ")
        values[f"bound_{place}"] = self._bound(trial, key, f"{key}_{place}")

    def _bound(self, trial: Trial, key: str, name: str) -> float:
        """Draw the bound of a condition `key` to three significant digits; `name` of optuna."""
        low, high = self.ranges[key]
        if key == NEIGHBORS:
            return trial.suggest_int(name, round(low), round(high))
        bound = trial.suggest_float(name, low, high, log=key in _LOG)
        return min(max(float(f"{bound:.3g}"), low), high)


class MissionFileSpace(Missions, ParameterSpace):
    """One mission with numbers to search: `parameters` are dotted keys of the mission's file."""

    def __init__(
        self,
        groups: Sequence[str],
        path: Path,
        data: Mapping[str, Any],
        parameters: Sequence[Parameter],
        folder: Path,
        *,
        is_present: bool,
    ) -> None:
        """`data`: contents of the file at `path`. `is_present`: the scenario runs this file."""
        super().__init__(parameters)
        self.groups, self.folder = tuple(groups), folder
        self._path = path
        self._data = data
        self._is_present = is_present

    @property
    def text(self) -> list[str]:
        """The file with its digest, and a line for each parameter: key and range."""
        digest = hashlib.sha256(_yaml(self._data).encode()).hexdigest()[:10]
        return [f"mission {self._path.name} {digest}", *super().text]

    @property
    def present(self) -> dict[str, Any] | None:
        """The file's values; None if the scenario does not run the file, or one is out of range."""
        return super().present if self._is_present else None

    def mission(self, values: Mapping[str, Any]) -> str:
        """The file of the mission with these values."""
        changes = {parameter.key: values[parameter.name] for parameter in self.parameters}
        return _yaml({**self._data, **nested(changes, self._data, SOURCE)})


def mission_file_space(
    scenario: Scenario, path: Path, words: Iterable[str], folder: Path
) -> MissionFileSpace:
    """The search space of numbers in the mission's file at `path`, for a tuning of `scenario`.

    - `words`: dotted keys with ranges, such as `sequence.0.until.probability=0.01..1`; if empty,
      all probabilities of the file are searched.
    - `folder`: where the missions of candidates are written.

    ConfigError if the file or a word is wrong. ConfigError also if the scenario cannot run the
    candidates: no robot runs a pattern from the start, a replaced pattern has parameters, or
    another pattern of the scenario is a file of its plugin_dir.
    """
    data = read(path)
    installed = pattern_names(None)
    # Patterns of the scenario's plugin_dir are not found, since the candidates' folder replaces it.
    find = PatternLoader(
        {name: (origin.value, origin.is_file) for name, origin in installed.items()}
    )
    mission_class(path, find)  # raises ConfigError for a fault of the file
    for pattern in patterns_of(scenario):
        if scenario.plugin_dir is not None and pattern not in (path.stem, *installed):
            raise ConfigError(
                f"--mission and pattern {pattern} of {scenario.plugin_dir}: candidates lie in a"
                " folder of their own; install this pattern as a package"
            )
    # The candidates replace the file; if no group runs the file, they replace all patterns.
    groups_of_file = _groups_of_file(scenario, path)
    groups = groups_of_file or _groups(scenario)
    _check_groups(scenario, groups, path.stem)
    words = list(words) or [f"{key}={_SPAN}" for key in _probabilities(data, shown(path))]
    parameters = [_number_of_file(word, data, path) for word in words]
    if not parameters:
        raise ConfigError(
            f"--mission {shown(path)}: has no probability; name what is searched with"
            f" {SOURCE} KEY=LO..HI, such as sequence.0.until.timeout=5..60"
        )
    check_keys(parameters)
    is_present = bool(groups_of_file)
    space = MissionFileSpace(groups, path, data, parameters, folder, is_present=is_present)
    _check_values(space, path, find)
    return space


def _groups_of_file(scenario: Scenario, path: Path) -> tuple[str, ...]:
    """The groups that run the mission's file at `path` from the start."""
    origin = pattern_names(scenario.plugin_dir).get(path.stem)
    is_this_file = origin is not None and is_same_file(origin.value, str(path))
    return _groups(scenario, path.stem) if is_this_file else ()


def _number_of_file(word: str, data: Mapping[str, Any], path: Path) -> Parameter:
    """The parameter that `word` names in `data`; ConfigError unless the file has a value there."""
    parameter = file_parameter(word, data, shown(path))
    if parameter.present is None or isinstance(parameter.present, dict | list):
        is_missing = parameter.present is None
        fault = "has no such value" if is_missing else f"has {brief(parameter.present)}"
        raise ConfigError(
            f"{SOURCE} {parameter.key}: {shown(path)} {fault}; expected one value there"
        )
    return parameter


def _check_values(space: MissionFileSpace, path: Path, find: Find) -> None:
    """ConfigError if the mission is refused with a bound or a choice of a parameter."""
    present = {parameter.name: parameter.present for parameter in space.parameters}
    with TemporaryDirectory() as folder:
        tried = Path(folder) / path.name
        for parameter in space.parameters:
            for value in parameter.choices or (parameter.low, parameter.high):
                tried.write_text(
                    space.mission({**present, parameter.name: value}), encoding="utf-8"
                )
                try:
                    mission_class(tried, find)
                except ConfigError as error:
                    # Without the line number and the path, which is that of a temporary file.
                    text = str(error).removeprefix(f"{shown(tried)}:").partition(" ")[2]
                    raise ConfigError(
                        f"{SOURCE} {parameter.key}: {value} is refused: {text}"
                    ) from error


def mission_space(
    scenario: Scenario, modules: Iterable[str], words: Iterable[str], folder: Path
) -> MissionSpace:
    """The search space of missions that are composed of the patterns `modules`.

    In `scenario`, a mission replaces the pattern of each group that runs a pattern from the start.
    `words`: bounds of conditions, such as `timeout=5..60` (s), `nearer=0.3..1` (m) or
    `reading:light=0..100`. `folder`: where the missions of candidates are written. ConfigError if a
    pattern or a condition is unknown, if no group runs a pattern from the start, if a replaced
    pattern has parameters, or if the scenario has a plugin_dir.
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
    groups = _groups(scenario)
    _check_groups(scenario, groups)

    ranges = dict(RANGES)
    robots = [robot for name in groups for robot in scenario.groups[name]]
    for word in words:
        key, bounds = _condition_bounds(word)
        for robot in robots:
            if key.startswith(READING) and key not in scenario.robots[robot].provides:
                raise ConfigError(f"{SOURCE} {key}: {robot} has no such reading; leave it out")
        ranges[key] = bounds
    return MissionSpace(groups, modules, ranges, folder)


def _condition_bounds(word: str) -> tuple[str, tuple[float, float]]:
    """The condition of KEY=LO..HI and its bounds; ConfigError for an unknown key, or bad bounds."""
    key = word.partition("=")[0]
    is_reading = key.startswith(READING) and key != READING  # with a name behind the prefix
    if key not in (*RANGES, NEIGHBORS) and not is_reading:
        wanted = ", ".join((*RANGES, NEIGHBORS, f"{READING}NAME"))
        raise ConfigError(f"{SOURCE} {key}: with --mission it is one of {wanted}")
    low, high = parse_range(word)
    if key in RANGES and low <= 0.0:
        raise ConfigError(f"{SOURCE} {word}: expected bounds above 0, such as {key}=0.5..1")
    if key == PROBABILITY and high > 1.0:
        raise ConfigError(f"{SOURCE} {word}: expected bounds up to 1, such as {key}=0.01..1")
    are_whole = low.is_integer() and high.is_integer()
    if key == NEIGHBORS and (low < 0.0 or not are_whole):
        raise ConfigError(f"{SOURCE} {word}: expected whole numbers, such as {key}=1..6")
    return key, (low, high)


def _groups(scenario: Scenario, pattern: str = "") -> tuple[str, ...]:
    """The groups that run `pattern` from the start; with an empty name, those that run any."""
    sections = scenario.effective["groups"].items()
    return tuple(
        name
        for name, group in sections
        if group["pattern"] and (not pattern or group["pattern"] == pattern)
    )


def _check_groups(scenario: Scenario, groups: Sequence[str], mission: str = "") -> None:
    """ConfigError without groups, or if a group has parameters that are not of `mission`."""
    if not groups:
        raise ConfigError(f"--mission: no group of scenario {scenario.name} begins with a pattern")
    for name in groups:
        group = scenario.effective["groups"][name]
        if group["parameters"] and group["pattern"] != mission:
            raise ConfigError(
                f"--mission: groups.{name}.parameters are those of {group['pattern']}; take a"
                " scenario without them"
            )


def _probabilities(data: Mapping[str, Any], what: str) -> Iterator[str]:
    """The dotted keys of all probabilities among the conditions of a mission's file.

    `what` is the file in messages. ConfigError for a probability below a name that has a dot.
    """
    elements = {
        key: element for key, element in data.items() if key not in MissionFile.__struct_fields__
    }
    for place in _places(elements):
        if dotted := next((key for key in place if "." in key), None):
            raise ConfigError(
                f"--mission {what}: the name {dotted!r} has a dot, which separates keys here; take"
                " another name for this step"
            )
        yield ".".join(place)


def _places(data: Any, keys: tuple[str, ...] = ()) -> Iterator[tuple[str, ...]]:
    """The keys from the root to each probability in nested dicts and lists `data`.

    `keys`: from the root to `data`.
    """
    items = data.items() if isinstance(data, dict) else enumerate(data)
    for key, value in items:
        place = (*keys, str(key))
        if isinstance(value, dict | list):
            yield from _places(value, place)
        elif key == PROBABILITY:
            yield place


def _state(key: str) -> int:
    """The number of the state that a value such as bound_2_1 belongs to; 0: the whole mission."""
    words = key.split("_")
    return int(words[1]) if len(words) > 1 else 0


def _reached(values: Mapping[str, Any], states: int) -> set[int]:
    """The states that transitions reach from state 1, itself included."""
    reached, to_visit = set[int](), [1]
    while to_visit:
        n = to_visit.pop()
        if n not in reached:
            reached.add(n)
            keys = (f"target_{n}_{k}" for k in range(1, MAX_TRANSITIONS + 1))
            to_visit += [values[key] for key in keys if key in values]
    return reached


def _transitions(
    values: Mapping[str, Any], n: int, names: Mapping[int, str]
) -> dict[str, dict[str, Any]]:
    transitions = {}
    for k in range(1, MAX_TRANSITIONS + 1):
        target, chance = values.get(f"target_{n}_{k}"), values.get(f"chance_{n}_{k}")
        if target is not None:
            condition = _condition(values, f"{n}_{k}")
            if chance is not None:
                condition = {"all": [condition, {PROBABILITY: chance}]}
            transitions[names[target]] = condition
    return transitions


def _condition(values: Mapping[str, Any], place: str) -> dict[str, Any]:
    """The condition of a state or transition; {} if it has none."""
    name = values.get(f"condition_{place}")
    if name is None:
        return {}
    bound = values[f"bound_{place}"]
    is_not = name.startswith("not ")
    plain = name.removeprefix("not ")
    if plain.startswith(READING):
        side = "below" if is_not else "above"
        return {"reading": plain.removeprefix(READING), side: bound}
    condition = {plain: bound}
    return {"not": condition} if is_not else condition


def _keyed(key: str, condition: dict[str, Any]) -> dict[str, Any]:
    return {key: condition} if condition else {}


def _yaml(data: Mapping[str, Any]) -> str:
    return text_of(dict(data), flow=None, width=100)
