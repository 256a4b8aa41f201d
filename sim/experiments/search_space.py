"""The search space of a tuning: keys of a scenario, each with its bounds or choices.

By default the keys are the parameters of the scenario's patterns, with their declared bounds.
"""

from __future__ import annotations

import math
import re
from collections import Counter
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any, NamedTuple

from swarmd.core.errors import ConfigError, unknown
from swarmd.core.numbers import finite_number
from swarmd.core.values import Platform
from swarmd.kit.params import Params, ParamSpec, build, derived_defaults, schema
from swarmd.pattern_host.loader import PatternLoader
from swarmd.plugins import pattern_names
from swarmd.sim.scenarios.overrides import parse_override
from swarmd.sim.scenarios.scenario import Scenario

if TYPE_CHECKING:
    from optuna.distributions import BaseDistribution

SOURCE = "--param"
_LOG_FROM = 100.0
"""Bounds above 0 with at least this ratio are searched by their logarithm."""
_RANGE = re.compile(r"\s*([^.\s]\S*?|\.\d\S*?)\s*\.\.\s*(\S+?)\s*")
_EXAMPLE = "KEY=0.1..0.5, KEY=1..8 or KEY=a,b,c"


@dataclass(frozen=True, slots=True)
class Parameter:
    """A key of a scenario that a tuning searches, between `low` and `high` or among `choices`."""

    key: str
    name: str  # as tables show the key
    low: float = 0.0
    high: float = 0.0
    is_int: bool = False
    choices: tuple[Any, ...] = ()  # instead of `low` and `high`
    pattern: str = ""  # the pattern whose parameter the key sets; empty for other keys
    param: str = ""  # the name of the pattern's parameter
    unit: str = ""
    present: Any = None  # the value in the scenario; None if unknown

    @property
    def is_log(self) -> bool:
        """Whether its logarithm is searched."""
        return not self.choices and self.low > 0.0 and self.high / self.low >= _LOG_FROM

    @property
    def range(self) -> str:
        """Its values as text: `0.1..0.5`, or `a,b,c`."""
        if self.choices:
            return ",".join(map(str, self.choices))
        return f"{self.low:g}..{self.high:g}"

    def distribution(self) -> BaseDistribution:
        """The distribution of optuna; choices by their index."""
        from optuna.distributions import (
            CategoricalDistribution,
            FloatDistribution,
            IntDistribution,
        )

        if self.choices:
            return CategoricalDistribution(range(len(self.choices)))
        if self.is_int:
            return IntDistribution(int(self.low), int(self.high), log=self.is_log)
        return FloatDistribution(self.low, self.high, log=self.is_log)

    def value_of(self, number: Any) -> Any:
        """The value for a number of its distribution; floats have four significant digits."""
        if self.choices:
            return self.choices[number]
        return number if self.is_int else min(max(float(f"{number:.4g}"), self.low), self.high)

    def number_of(self, value: Any) -> int | float:
        """The value as a number; a choice as its index. ValueError if it is out of range."""
        if self.choices:
            return self.choices.index(value)
        if isinstance(value, bool) or not isinstance(value, int | float):
            raise ValueError(f"{value!r} is no number")
        if not self.low <= value <= self.high:
            raise ValueError(f"{value} is out of range")
        return value


class ParameterSpace:
    """The search space of a scenario's parameters."""

    def __init__(self, parameters: Sequence[Parameter]) -> None:
        self.parameters = tuple(parameters)

    @property
    def text(self) -> list[str]:
        """A line for each parameter: key and range."""
        return [f"{parameter.key}={parameter.range}" for parameter in self.parameters]

    @property
    def present(self) -> dict[str, Any] | None:
        """The scenario's own values, by name; None if a value is unknown or out of range."""
        present = {parameter.name: parameter.present for parameter in self.parameters}
        try:
            self.numbers(present)
        except ValueError:
            return None
        return present

    @property
    def distributions(self) -> dict[str, BaseDistribution]:
        """The distributions of optuna, by key."""
        return {parameter.key: parameter.distribution() for parameter in self.parameters}

    def values(self, numbers: Mapping[str, Any]) -> dict[str, Any]:
        """The values by name, for numbers by key that optuna has drawn."""
        return {one.name: one.value_of(numbers[one.key]) for one in self.parameters}

    def numbers(self, values: Mapping[str, Any]) -> dict[str, int | float]:
        """The numbers by key, for values by name; ValueError if a value is out of range."""
        return {one.key: one.number_of(values[one.name]) for one in self.parameters}

    def overrides(self, values: Mapping[str, Any]) -> dict[str, Any]:
        """The overrides of a scenario, by dotted key."""
        return {parameter.key: values[parameter.name] for parameter in self.parameters}


class Declared(NamedTuple):
    """A parameter of a pattern with its declared bounds."""

    parameter: Parameter
    exclusion: str
    """Why a tuning leaves the parameter out unless the user gives bounds; empty if the declared
    bounds suffice."""


def parameter_space(
    scenario: Scenario, words: Iterable[str] = (), on_note: Callable[[str], object] = str
) -> ParameterSpace:
    """The search space of a tuning of `scenario`, from the values of `--param`.

    `words`: each is KEY=LO..HI, KEY=A,B,C or KEY. KEY is a dotted key of the scenario, or the name
    of a pattern's parameter. KEY alone stands for the parameter's declared bounds. Without words,
    the space has all parameters of the scenario's patterns whose declaration has bounds, and
    `on_note` is called with a line about each parameter without. ConfigError names the wrong word.
    """
    declared = _declared(scenario)
    parameters = [_parameter(word, declared, scenario.effective) for word in words]
    if not parameters:
        parameters = _bounded(declared, on_note)
    if not parameters:
        raise ConfigError(
            f"scenario {scenario.name} runs no pattern with parameters to tune; name keys with"
            f" {SOURCE} {_EXAMPLE}"
        )
    keys = Counter(parameter.key for parameter in parameters)
    if (repeated := next((key for key, count in keys.items() if count > 1), None)) is not None:
        raise ConfigError(f"{SOURCE} {repeated} is given twice; keep one")
    return ParameterSpace(parameters)


def _bounded(declared: Sequence[Declared], on_note: Callable[[str], object]) -> list[Parameter]:
    """The parameters that are tuned by default; `on_note` gets a line about each other parameter.

    The parameters of all patterns, such as `recovery`, get no line.
    """
    parameters = []
    for parameter, exclusion in declared:
        is_of_all_patterns = parameter.param in Params.__struct_fields__
        if not exclusion:
            parameters.append(parameter)
        elif not is_of_all_patterns:
            name = parameter.name
            on_note(f"{name} is not tuned: {exclusion}; name it with {SOURCE} {name}=LO..HI")
    return parameters


def parse_range(word: str) -> tuple[float, float]:
    """The bounds of KEY=LO..HI; ConfigError unless both are finite, and LO is below HI."""
    match = _RANGE.fullmatch(word.partition("=")[2])
    low, high = map(finite_number, match.groups() if match else ("", ""))
    if not low < high:
        raise ConfigError(f"{SOURCE} {word}: expected LO..HI with LO below HI, such as 0.1..0.5")
    return low, high


def patterns_of(scenario: Scenario) -> tuple[str, ...]:
    """The patterns that its robots run, from the start or by an event."""
    groups = scenario.effective["groups"].values()
    names = [group["pattern"] for group in groups if group["pattern"]]
    names += [event.pattern for event in scenario.events if event.pattern]
    return tuple(dict.fromkeys(names))


def _declared(scenario: Scenario) -> list[Declared]:
    """Each parameter of the scenario's patterns.

    The bounds of a speed are also limited to plus and minus the speed limit of the slowest robot
    that runs the pattern.
    """
    origins = pattern_names(scenario.plugin_dir)
    load = PatternLoader({name: (o.value, o.is_file) for name, o in origins.items()})
    params_types = [(name, load(name).params_type) for name in patterns_of(scenario)]
    # A parameter name of several patterns is preceded by the pattern's name.
    count = Counter(spec.name for _, params_type in params_types for spec in schema(params_type))
    declared = []
    for pattern, params_type in params_types:
        robot = _robot_of(scenario, pattern)  # the slowest: its values and limits stand for all
        platform = scenario.robots[robot]
        platform_defaults = {**derived_defaults(params_type, platform)}
        layers = (("platform", platform_defaults), *scenario.parameters[robot].layers(pattern, ()))
        _, values_and_sources = build(params_type, layers)  # by name of the parameter
        for spec in schema(params_type):
            present, _ = values_and_sources[spec.name]
            name = spec.name if count[spec.name] == 1 else f"{pattern}.{spec.name}"
            parameter = Parameter(
                _key(scenario, pattern, spec.name),
                name,
                pattern=pattern,
                param=spec.name,
                unit=spec.unit,
                present=present,
            )
            declared.append(_with_bounds(parameter, spec, platform))
    return declared


def _with_bounds(parameter: Parameter, spec: ParamSpec, platform: Platform) -> Declared:
    """The parameter with its declared bounds or choices, limited to the speeds of `platform`."""
    if spec.name in Params.__struct_fields__:
        choices = spec.choices or (True, False)
        return Declared(replace(parameter, choices=choices), "it is a parameter of all")
    if spec.choices:
        return Declared(replace(parameter, choices=spec.choices), "")
    if spec.type == "bool":
        return Declared(replace(parameter, choices=(False, True)), "")
    if spec.type == "str":
        return Declared(parameter, "it is any text")
    parameter = replace(parameter, is_int=spec.type == "int")
    if spec.ge is None or spec.le is None:
        return Declared(parameter, f"it has no {'lower' if spec.ge is None else 'upper'} bound")
    limits = {"m/s": platform.limits.linear, "rad/s": platform.limits.angular}
    limit = limits.get(spec.unit, math.inf)
    if spec.name == "lateral" and spec.unit == "m/s":
        limit = platform.limits.lateral
        if limit == 0.0:
            return Declared(parameter, f"{platform.name} does not move sideways")
    low = max(spec.ge, -limit)
    high = min(spec.le, limit)
    exclusion = "" if low < high else "it has one value"
    return Declared(replace(parameter, low=low, high=high), exclusion)


def _robot_of(scenario: Scenario, pattern: str) -> str:
    """The slowest robot that begins with the pattern; if none does, the slowest of all robots.

    No robot begins with a pattern that only an event starts.
    """
    groups = scenario.effective["groups"]
    ids = [
        robot
        for name, robots in scenario.groups.items()
        for robot in robots
        if groups[name]["pattern"] == pattern
    ]
    return min(ids or scenario.robots, key=lambda robot: scenario.robots[robot].limits.linear)


def _key(scenario: Scenario, pattern: str, name: str) -> str:
    """The dotted key of a scenario that sets a pattern's parameter.

    The key is that of the first group that sets the parameter already. If no group sets the
    parameter, the key is that for all robots, `parameters.PATTERN.NAME`.
    """
    for group, section in scenario.effective["groups"].items():
        if section["pattern"] == pattern and name in section["parameters"]:
            return f"groups.{group}.parameters.{name}"
    return f"parameters.{pattern}.{name}"


def _parameter(
    word: str,
    declared: Sequence[Declared],
    data: Mapping[str, Any],
) -> Parameter:
    """The parameter to search that one value of `--param` names: KEY, KEY=LO..HI or KEY=A,B,C.

    `declared`: the parameters of patterns, from `_declared`. `data`: the scenario, in which a
    dotted key is looked up. ConfigError if the word is wrong.
    """
    key, equals, text = (part.strip() for part in word.partition("="))
    by_key = {row.parameter.name: row for row in declared}
    by_key |= {row.parameter.key: row for row in declared}
    known = by_key.get(key)
    names = [row.parameter.name for row in declared]
    if not equals:
        if known is None:
            raise ConfigError(f"{SOURCE} {unknown('parameter', key, names)}; or give {_EXAMPLE}")
        # By its name, also a parameter is searched that is not searched by default. Without bounds
        # or choices there is nothing to search.
        if known.exclusion and not known.parameter.choices:
            raise ConfigError(f"{SOURCE} {key}: {known.exclusion}; give {key}=LO..HI")
        return known.parameter
    if known is None and "." not in key:
        raise ConfigError(
            f"{SOURCE} {unknown('parameter', key, names)}; or give a dotted key of the scenario"
        )
    parameter = (
        Parameter(key, key, present=_present(data, key)) if known is None else known.parameter
    )
    is_range = _RANGE.fullmatch(text) is not None
    if not is_range:
        return _with_choices(parameter, word, f"{key}={text}")
    if parameter.choices:
        raise ConfigError(f"{SOURCE} {key} has no range; expected values such as {key}=a,b")
    return _with_range(parameter, word, text)


def _with_choices(parameter: Parameter, word: str, text: str) -> Parameter:
    """The parameter with the choices of `text`, KEY=A,B,C, in place of its bounds or choices.

    `word`: the text as the user gave it.
    """
    _, values = parse_override(text, SOURCE, "[{}]")  # read as a YAML list
    if not values or any(isinstance(value, dict | list) for value in values):
        raise ConfigError(f"{SOURCE} {word}: expected {_EXAMPLE}")
    return replace(parameter, choices=tuple(dict.fromkeys(values)), low=0.0, high=0.0)


def _with_range(parameter: Parameter, word: str, text: str) -> Parameter:
    """The parameter with the range `text`, LO..HI, of the word KEY=LO..HI.

    A pattern's parameter is searched in whole numbers if its type is int. Any other key of the
    scenario is searched in whole numbers if both bounds are whole numbers.
    """
    low, high = parse_range(word)
    are_whole = all(re.fullmatch(r"[+-]?\d+", bound.strip()) for bound in text.split(".."))
    is_pattern_parameter = bool(parameter.param)
    is_int = parameter.is_int if is_pattern_parameter else are_whole
    if is_int and not are_whole:
        key = word.partition("=")[0].strip()
        raise ConfigError(f"{SOURCE} {word}: expected whole numbers, such as {key}=1..8")
    return replace(parameter, low=low, high=high, is_int=is_int)


def _present(data: Mapping[str, Any], key: str) -> Any:
    """The value of a dotted key of a scenario; None if it is not set."""
    value: Any = data
    for part in key.split("."):
        if isinstance(value, list) and part.isdecimal() and int(part) < len(value):
            value = value[int(part)]
        elif isinstance(value, Mapping):
            value = value.get(part)
        else:
            return None
    return value
