"""Makes the parts of a mission, and tries every value that its maps can give them."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from functools import partial
from typing import Any

import msgspec

from swarmd.core.errors import SwarmError, unknown
from swarmd.core.values import Inputs
from swarmd.kit.behavior import Make, Pattern
from swarmd.kit.combined import outer_name
from swarmd.kit.conditions import Compared, Scalar, Settled, leaves
from swarmd.kit.diagnostics import Faults, Keys
from swarmd.kit.params import build, schema
from swarmd.kit.voting_pattern import OPINION, VotingPattern
from swarmd.mission.schema import Document, MapSpec, PartSpec, Table, conditions_of

Exposed = Mapping[str, Mapping[str, Any]]
"""By part, the values that the mission's own parameters give."""


@dataclass(slots=True, eq=False)
class Company:
    """The parts of a mission by name, and what each of its maps sets by what is reported."""

    parts: dict[str, Pattern[Any]] = field(default_factory=dict)
    tables: list[tuple[MapSpec, Table]] = field(default_factory=list)


def make_company(document: Document, make: Make, exposed: Exposed, faults: Faults) -> Company:
    """All parts, each made as it will run; what is wrong is noted, and such a part left out."""
    company = Company()
    for name, part in document.parts.items():
        made = _noting(faults, part.keys, partial(_made, part, make, exposed))
        if made is not None:
            company.parts[name] = made
    _check_voices(document, company, faults)
    trial = _Trial(document, make, exposed)
    company.tables = tables_of(document, company.parts, trial, faults)
    _check_reports(document, company, trial, faults)
    return company


class _Trial:
    """Makes parts that nobody runs, to try something out on."""

    def __init__(self, document: Document, make: Make, exposed: Exposed) -> None:
        self._document, self._make, self._exposed = document, make, exposed

    def __call__(self, name: str, **more: Any) -> Pattern[Any]:
        return _made(self._document.parts[name], self._make, self._exposed, **more)


def trial_of(document: Document, make: Make, exposed: Exposed) -> Callable[..., Pattern[Any]]:
    """From a part's name, and parameters to change, to such a part that nobody runs."""
    return _Trial(document, make, exposed)


def tables_of(
    document: Document,
    parts: Mapping[str, Pattern[Any]],
    trial: Callable[..., Pattern[Any]],
    faults: Faults,
    opinions: Mapping[str, int] | None = None,
) -> list[tuple[MapSpec, Table]]:
    """What each map sets, every value tried: as the target starts with it and as it is changed.

    `opinions`: how many a part is to have, if not as many as it has now.
    """
    found: list[tuple[MapSpec, Table]] = []
    for spec in document.maps:
        source, target = (parts.get(name) for name, _ in (spec.source, spec.target))
        if source is None or target is None:
            continue
        known = {name: getattr(source.params, "opinions", 0) for name in (spec.source[0],)}
        count = {**known, **(opinions or {})}[spec.source[0]]
        rows = _rows(spec, isinstance(source, VotingPattern), count, faults)
        if rows is None:
            continue
        table: dict[Scalar, Scalar] = {}
        for reported, value in rows.items():
            name = ".".join(spec.target)
            where = f"sets {name} to {value} where {'.'.join(spec.source)} is {reported}"
            call = partial(_tried, spec, value, trial)
            tried = _noting(faults, spec.keys, call, f"{where}: ")
            if tried is not None:
                table[reported] = tried
        found.append((spec, table))
    return found


def _rows(spec: MapSpec, is_vote: bool, opinions: int, faults: Faults) -> Table | None:
    """The map's values by what is reported; None with a fault if some are missing."""
    is_opinion = is_vote and spec.source[1] == OPINION
    if spec.table is None and not is_opinion:
        text = f"has base and step; give count, since {'.'.join(spec.source)} is no vote's opinion"
        faults.add(spec.keys, text)
        return None
    if spec.table is None:
        return {opinion: spec.base + spec.step * opinion for opinion in range(opinions)}
    missing = [k for k in range(opinions) if k not in spec.table] if is_opinion else []
    if missing:
        text = f"has no value for opinion {missing[0]}; {spec.source[0]} has {opinions} opinions"
        faults.add((*spec.keys, "values"), text)
        return None
    return spec.table


def _tried(spec: MapSpec, value: Scalar, trial: Callable[..., Pattern[Any]]) -> Scalar:
    """The value as the target's parameter holds it; SwarmError if it would be refused."""
    part, name = spec.target
    started = trial(part, **{name: value})
    changed = trial(part)
    changed.update(with_values(changed, {name: value}, "map"))
    return msgspec.to_builtins(getattr(started.params, name))  # type: ignore[no-any-return]


def with_values(part: Pattern[Any], values: Mapping[str, Any], source: str) -> Any:
    """A part's parameters with some of them changed; ConfigError if one is wrong."""
    whole = {**msgspec.structs.asdict(part.params), **values}
    return build(type(part.params), ((source, whole),))[0]


def _check_voices(document: Document, company: Company, faults: Faults) -> None:
    """Note parts that would say two things on one channel."""
    voices: dict[str, str] = {}
    for name, part in company.parts.items():
        for channel in sorted(outer_name(part, channel) for channel in part.channels):
            other = voices.setdefault(channel, name)
            if other != name:
                text = f"talks on {channel} as {other} does; make one private or leave it out"
                faults.add(document.parts[name].keys, text)
                break


def _made(part: PartSpec, make: Make, exposed: Exposed, **more: Any) -> Pattern[Any]:
    params = {**part.params, **exposed.get(part.name, {}), **more}
    return make(part.pattern, part=part.name, private=part.is_private, **params)


def _check_reports(
    document: Document, company: Company, trial: Callable[..., Pattern[Any]], faults: Faults
) -> None:
    """Note keys that a part does not report; one that reports nothing yet may report anything."""
    known: dict[str, set[str]] = {}

    def check(keys: Keys, part: str, key: str, more: set[str]) -> None:
        if part not in company.parts:
            return
        if part not in known:
            known[part] = _reported(trial, part)
        if known[part] and key not in known[part] | more:
            faults.add(keys, f"{unknown('report', key, known[part] | more)} (of {part})")

    for spec in document.maps:
        check((*spec.keys, "from"), *spec.source, set())
    for own, (part, key) in document.report.items():
        some = company.parts.get(part)
        params = set() if some is None else {one.name for one in schema(some.params_type)}
        check(("report", own), part, key, params)
    for keys, condition in conditions_of(document.root) if document.root is not None else ():
        for leaf in leaves(condition):
            if isinstance(leaf, Settled) or (isinstance(leaf, Compared) and not leaf.is_reading):
                name = leaf.report if isinstance(leaf, Settled) else leaf.name
                part, _, key = name.partition(".")
                check(keys, part, key, set())


def _reported(trial: Callable[..., Pattern[Any]], name: str) -> set[str]:
    try:
        return set(trial(name).step(Inputs(now=0.0, dt=0.0)).report)
    except (Exception, SystemExit):  # a plugin may raise anything; its reports are not known
        return set()


def _noting(
    faults: Faults, keys: Keys, call: Callable[[], Any], prefix: str = "cannot be made: "
) -> Any:
    """What the call gives; None if it raises, which is noted."""
    try:
        return call()
    except RecursionError:
        raise  # a part that is made of itself: each of its copies would note it
    except (Exception, SystemExit) as error:  # a plugin may raise anything
        faults.add(keys, f"{prefix}{words_of(error)}")
    return None


def words_of(error: BaseException) -> str:
    """What was raised, on one line; with its type unless it is ours, and speaks for itself."""
    text = " ".join(str(error).split())
    return text if isinstance(error, SwarmError) else f"{type(error).__name__}: {text}"
