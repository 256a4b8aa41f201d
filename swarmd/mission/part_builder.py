"""Builds the parts and the setters (maps) of a mission, and tries each value a setter can set."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import partial
from typing import Any, TypeVar

import msgspec

from swarmd.core.bounds import BoundedScalar
from swarmd.core.errors import ParameterError, SwarmError, unknown
from swarmd.core.values import OPINION, Inputs
from swarmd.kit.behavior import Make, Pattern
from swarmd.kit.combined import outer_name
from swarmd.kit.conditions import simple_conditions
from swarmd.kit.mistakes import one_line
from swarmd.kit.params import build, schema
from swarmd.kit.voting_pattern import VotingPattern
from swarmd.mission.document import Document
from swarmd.mission.schema import Map, Reference, conditions, report_of, split
from swarmd.settings.layered import Fault, Keys, fault_at

Parts = Mapping[str, Pattern[Any]]
Table = Mapping[BoundedScalar, BoundedScalar]
T = TypeVar("T")
_NOT_MADE = "cannot be made: "


@dataclass(frozen=True, slots=True, eq=False)
class PartBuilder:
    """Makes the parts (patterns) of a mission by name, and collects the faults.

    `exposed`: by part, the values of those parameters that are the mission's own parameters, too.
    """

    document: Document
    make: Make
    exposed: Mapping[str, Mapping[str, Any]]
    faults: list[Fault]

    def __call__(self, name: str, **changes: Any) -> Pattern[Any]:
        """A new part, with some parameters changed; SwarmError if a value is refused."""
        part = self.document.parts[name]
        params = {**part.params, **self.exposed.get(name, {}), **changes}
        return self.make(part.pattern, part=name, private=part.private, **params)


@dataclass(frozen=True, slots=True, eq=False)
class Setter:
    """Sets a parameter of the target part by a report of the source part; `table` maps values."""

    source: Reference
    target: Reference
    table: Table


def build_parts(builder: PartBuilder) -> dict[str, Pattern[Any]]:
    """All parts that can be made; a part is made without parameters that it refuses."""
    built = {name: _built(builder, name) for name in list(builder.document.parts)}
    parts = {name: part for name, part in built.items() if part is not None}
    senders: dict[str, str] = {}
    for name, part in parts.items():
        for channel in sorted(outer_name(part, channel) for channel in part.channels):
            sender = senders.setdefault(channel, name)
            if sender != name:
                text = f"sends on {channel} as {sender} does; make one private or leave it out"
                builder.faults.append(fault_at(("parts", name), text))
                break
    return parts


def build_setters(
    builder: PartBuilder, parts: Parts, opinions: Mapping[str, int] | None = None
) -> list[Setter]:
    """Make a setter for each map of the mission whose two parts are among `parts`.

    A map sets a parameter of the target part by the report of a source part. A value of a map that
    the target refuses adds a fault to the builder. `opinions`: the number of opinions of each part
    whose parameter `opinions` is about to change; the number of any other voting part is its
    present parameter.
    """
    new_opinion_counts = opinions or {}
    setters = []
    for keys, mapping in builder.document.maps:
        source = split(mapping.source)
        target = split(mapping.target)
        (source_part, source_report) = source
        (target_part, target_parameter) = target
        if source_part not in parts or target_part not in parts:
            continue
        # An unknown parameter is reported here once, instead of once for each value.
        valid_names = [spec.name for spec in schema(parts[target_part].params_type)]
        if target_parameter not in valid_names:
            text = f"names {unknown('parameter', target_parameter, valid_names)} (of {target_part})"
            builder.faults.append(fault_at((*keys, "to"), text))
            continue
        pattern = parts[source_part]
        is_opinion_of_a_vote = isinstance(pattern, VotingPattern) and source_report == OPINION
        opinion_count: int | None = None
        if is_opinion_of_a_vote:
            present_count = getattr(pattern.params, "opinions", 0)
            opinion_count = new_opinion_counts.get(source_part, present_count)
        values = _values(builder, keys, mapping, opinion_count)
        setters.append(Setter(source, target, _accepted(builder, keys, mapping, values)))
    return setters


def _accepted(builder: PartBuilder, keys: Keys, mapping: Map, values: Table) -> Table:
    """The entries of a map's table that the target accepts, with values of the parameter's type.

    Each refused value adds a fault.
    """
    accepted: dict[BoundedScalar, BoundedScalar] = {}
    for reported, value in values.items():
        prefix = f"sets {mapping.target} to {value} where {mapping.source} is {reported}: "
        try_value = partial(_tried, builder, split(mapping.target), value)
        converted = _noting(builder, keys, try_value, prefix)
        if converted is not None:
            accepted[reported] = converted
    return accepted


def check_reports(builder: PartBuilder, parts: Parts) -> None:
    """Add a fault for each reference to a report that a part does not have.

    The reports of a part are those of its first step. A part that reports nothing in its first step
    may have any report later.
    """
    document = builder.document
    reports = {part: _reports(builder, part) for part in parts}

    def check(keys: Keys, reference: Reference, further_names: set[str]) -> None:
        """Check `reference` (part, report), which stands at the place `keys` of the file.

        `further_names`: what the place may name besides the reports of the part.
        """
        part, report = reference
        known_reports = reports.get(part, set())
        valid_names = known_reports | further_names
        if known_reports and report not in valid_names:
            text = f"names {unknown('report', report, valid_names)} (of {part})"
            builder.faults.append(fault_at(keys, text))

    for keys, mapping in document.maps:
        check((*keys, "from"), split(mapping.source), set())
    for name, reference in document.report.items():
        # A mission may also report the parameters of its parts.
        part = parts.get(reference[0])
        params = {spec.name for spec in schema(part.params_type)} if part is not None else set()
        check(("report", name), reference, params)
    for keys, condition in conditions(document.root):
        for simple_condition in simple_conditions(condition):
            report = report_of(simple_condition)
            if report is not None:
                check(keys, split(report), set())


def _built(builder: PartBuilder, name: str) -> Pattern[Any] | None:
    """Make a new part; add a fault to the builder for each parameter that the part refuses.

    A refused parameter is left out and the part is made again, so that all faults are found. None,
    with a fault, if the part cannot be made.
    """
    while True:
        try:
            return builder(name)
        except RecursionError:
            raise  # a part that contains itself: each nested copy would add this fault again
        except (Exception, SystemExit) as error:  # a plugin may raise anything
            if not _leave_out(builder, name, error):
                builder.faults.append(fault_at(("parts", name), _NOT_MADE + error_text(error)))
                return None


def _leave_out(builder: PartBuilder, name: str, error: BaseException) -> bool:
    """Leave out the parameter of part `name` that `error` refuses, and add a fault; True if done.

    Only a parameter whose value stands in the part's section of the file can be left out. False if
    `error` refuses no parameter, or a parameter whose value comes from elsewhere, such as from a
    parameter of the mission.
    """
    part = builder.document.parts[name]
    key = error.parameter if isinstance(error, ParameterError) else ""
    if key not in part.params or key in builder.exposed.get(name, {}):
        return False
    text = f"is refused: {error_text(error)}"
    builder.faults.append(fault_at(("parts", name, "params", key), text))
    params = {param: value for param, value in part.params.items() if param != key}
    builder.document.parts[name] = msgspec.structs.replace(part, params=params)
    return True


def with_values(part: Pattern[Any], values: Mapping[str, Any], source: str) -> Any:
    """A part's parameters with some of them changed; ConfigError if one is wrong."""
    whole = {**msgspec.structs.asdict(part.params), **values}
    return build(type(part.params), ((source, whole),))[0]


def error_text(error: BaseException) -> str:
    """An exception in one line; with its type and place unless the exception is a SwarmError."""
    return " ".join(str(error).split()) if isinstance(error, SwarmError) else one_line(error)


def _values(builder: PartBuilder, keys: Keys, mapping: Map, opinions: int | None) -> Table:
    """The table of a map: the value of the target parameter by reported value.

    `keys`: the place of the map in the file. `opinions`: the number of opinions of the source part;
    None if the source is not the opinion of a vote. Returns {}, and adds a fault, if the map has
    no value for an opinion, or if it is not known how many numbers the source may report.
    """
    table: dict[BoundedScalar, BoundedScalar]
    if isinstance(mapping.values, list):  # values of the reported numbers 0, 1, 2 ...
        table = dict(enumerate(mapping.values))
    elif mapping.values is not None:  # values by reported text
        table = dict(mapping.values.items())
    else:  # base + step * reported number
        count = mapping.count or opinions
        if count is None:
            text = (
                f"has base and step, but {mapping.source} is not the opinion of a vote; give count"
            )
            builder.faults.append(fault_at(keys, text))
            return {}
        base = mapping.base or 0.0
        step = mapping.step or 0.0
        table = {number: base + step * number for number in range(count)}
    missing = [number for number in range(opinions or 0) if number not in table]
    if missing:
        source_part, _ = split(mapping.source)
        text = f"has no value for opinion {missing[0]}; {source_part} has {opinions} opinions"
        builder.faults.append(fault_at((*keys, "values"), text))
        return {}
    return table


def _tried(builder: PartBuilder, target: Reference, value: BoundedScalar) -> BoundedScalar:
    """The value after conversion by the target's parameter; SwarmError if the target refuses it."""
    part, name = target
    started = builder(part, **{name: value})
    changed = builder(part)
    changed.update(with_values(changed, {name: value}, "map"))
    return msgspec.to_builtins(getattr(started.params, name))  # type: ignore[no-any-return]


def _reports(builder: PartBuilder, name: str) -> set[str]:
    try:
        return set(builder(name).step(Inputs(now=0.0, dt=0.0)).report)
    except (Exception, SystemExit):  # a plugin may raise anything; its reports stay unknown
        return set()


def _noting(builder: PartBuilder, keys: Keys, call: Callable[[], T], prefix: str) -> T | None:
    """The result of the call; None if the call raises, which adds a fault."""
    try:
        return call()
    except RecursionError:
        raise  # a part that contains itself: each nested copy would add this fault again
    except (Exception, SystemExit) as error:  # a plugin may raise anything
        builder.faults.append(fault_at(keys, f"{prefix}{error_text(error)}"))
    return None
