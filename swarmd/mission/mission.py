"""Missions as patterns: a class for each file."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, ClassVar, TypeAlias, cast
from typing import get_type_hints as type_hints

import msgspec
from msgspec import NODEFAULT

from swarmd.errors import SwarmError
from swarmd.kit.behavior import Context, Pattern
from swarmd.kit.combined import CombinedPattern
from swarmd.kit.params import Params, Unstick
from swarmd.kit.voting import VotingPattern
from swarmd.mission.checking import (
    Company,
    make_company,
    tables_of,
    trial_of,
    with_values,
    words_of,
)
from swarmd.mission.conditions import Scalar, needs_of
from swarmd.mission.document import Document, read_document
from swarmd.mission.elements import conditions_of, drivers_of
from swarmd.mission.faults import Faults
from swarmd.mission.nodes import node_of
from swarmd.mission.places import refusal
from swarmd.mission.watch import Facts
from swarmd.values import Inputs, Outputs, Platform, Value

Find: TypeAlias = Callable[[str], type[Pattern[Any]]]
Kinds: TypeAlias = dict[str, type[Pattern[Any]]]


class Mission(CombinedPattern[Params]):
    """A pattern that a file composes of others; each file has a class of its own."""

    document: ClassVar[Document]
    kinds: ClassVar[Kinds]

    def __init__(self, params: Params, context: Context) -> None:
        super().__init__(params, context)
        assert self.document.root is not None
        self._root = node_of(self.document.root)
        self._has_begun = False
        self._reports: dict[str, Scalar] = {}
        self._done: set[str] = set()
        self._stepped: dict[str, Outputs] = {}

    @classmethod
    def defaults(cls, platform: Platform) -> Mapping[str, Value]:
        """What its file, or the platform, gives the parts that its parameters belong to."""
        found: dict[str, Value] = {}
        for own, (name, param) in cls.document.parameters.items():
            part, kind = cls.document.parts[name], cls.kinds[name]
            own_platform = platform.patterns.get(part.pattern, {})
            values = {**kind.defaults(platform), **own_platform, **part.params}
            if param in values:
                found[own] = values[param]
        return found

    def make_parts(self) -> Mapping[str, Pattern[Any]]:
        """All parts, and every value of every map tried; ConfigError for the first fault."""
        faults, document = Faults(), self.document
        self._company: Company = make_company(
            document, self.context.make, self._exposed(self.params), faults
        )
        if faults.found:
            raise refusal(document.path, faults.found)
        return self._company.parts

    def update(self, params: Params) -> None:
        """Hand changed parameters to their parts; ConfigError if one may not be so."""
        changes = {
            name: {k: v for k, v in values.items() if v != getattr(self.parts[name].params, k)}
            for name, values in self._exposed(params).items()
        }
        fresh = {
            name: with_values(self.parts[name], values, "update")
            for name, values in changes.items()
            if values
        }
        opinions = {n: values["opinions"] for n, values in changes.items() if "opinions" in values}
        document = self.document
        if opinions or any(spec.target[0] in fresh for spec in document.maps):
            faults = Faults()
            trial = trial_of(document, self.context.make, self._exposed(params))
            tables = tables_of(document, self.parts, trial, faults, opinions)
            if faults.found:
                raise refusal(document.path, faults.found)
            self._company.tables = tables
        for name, values in fresh.items():
            self.parts[name].update(values)
        super().update(params)

    def step(self, inputs: Inputs) -> Outputs:
        """One step of the parts whose turn it is."""
        if not self._has_begun:
            self._has_begun = True
            self._root.begin(inputs.now)
        facts = Facts(inputs.now, self._reports, self._done, inputs.scan, inputs.readings)
        self._stepped = {}
        twist = None
        if not self._root.check(facts):
            twist = self._root.step(self, inputs, facts)
        messages: dict[str, Value] = {}
        for outputs in self._stepped.values():
            messages.update(outputs.messages)
        return Outputs(twist, messages, self._report(), self._root.over or None)

    def run_part(self, name: str, inputs: Inputs) -> Outputs:
        """One step of a part; what it reports is mapped to the parameters of others at once."""
        outputs = self._stepped[name] = self.step_part(name, inputs)
        self._reports.update({f"{name}.{key}": value for key, value in outputs.report.items()})
        (self._done.discard if outputs.done is None else self._done.add)(name)
        for spec, table in self._company.tables:
            source, key = spec.source
            if source == name and key in outputs.report:
                self._set(*spec.target, table.get(outputs.report[key]))
        return outputs

    def _set(self, name: str, param: str, value: Scalar | None) -> None:
        part = self.parts[name]
        if value is not None and value != getattr(part.params, param):
            part.update(msgspec.structs.replace(part.params, **{param: value}))

    def _report(self) -> Mapping[str, Scalar]:
        found: dict[str, Scalar] = {"phase": self._root.phase}
        for own, (name, key) in self.document.report.items():
            value = self._reports.get(f"{name}.{key}", getattr(self.parts[name].params, key, None))
            if value is not None:
                found[own] = value
        if not self.document.report:
            for name, outputs in self._stepped.items():
                found.update({f"{name}.{key}": value for key, value in outputs.report.items()})
        return found

    def _exposed(self, params: Params) -> Mapping[str, Mapping[str, Any]]:
        """By part, what the mission's own parameters say."""
        found: dict[str, dict[str, Any]] = {}
        for own, (name, param) in self.document.parameters.items():
            found.setdefault(name, {})[param] = getattr(params, own)
        return found


def mission_class(path: Path, find: Find) -> type[Mission]:
    """The class of a file, checked as far as that can be without a robot.

    ConfigError for its first fault, with file and line.
    """
    document = read_document(path)
    kinds = kinds_of(document, find)
    params_type = _params_type(document, kinds)
    if document.faults.found or document.root is None:
        raise refusal(path, document.faults.found)
    needs = frozenset[str]().union(*(kind.needs for kind in kinds.values()))
    for _, condition in conditions_of(document.root):
        needs |= needs_of(condition)
    members = {
        "__doc__": document.description,
        "__module__": __name__,
        "document": document,
        "kinds": kinds,
        "params_type": params_type,
        "needs": needs,
        "channels": _channels(document, kinds),
        "rate": max(kind.rate for kind in kinds.values()),
    }
    return type(f"Mission_{path.stem}", (Mission,), members)


def kinds_of(document: Document, find: Find) -> Kinds:
    """The classes of the parts; those that are not there are noted as faults."""
    kinds: Kinds = {}
    for name, part in document.parts.items():
        try:
            kinds[name] = find(part.pattern)
        except (Exception, SystemExit) as error:  # a plugin may raise anything
            start = "" if isinstance(error, SwarmError) else "cannot be loaded: "
            document.faults.add((*part.keys, "pattern"), start + words_of(error))
    return kinds


def _params_type(document: Document, kinds: Kinds) -> type[Params]:
    """The mission's own parameters, each with type, bounds and meaning of its part's."""
    fields: list[Any] = []
    for own, (name, param) in document.parameters.items():
        if name not in kinds:
            continue
        kind = kinds[name].params_type
        known = {field.name: field for field in msgspec.structs.fields(kind)}
        if param not in known:
            keys = ("parameters", own)
            text = f"is of parameter {param!r}, which {document.parts[name].pattern} has not"
            document.faults.add(keys, f"{text}; there are: {', '.join(sorted(known))}")
            continue
        hint, default = type_hints(kind, include_extras=True)[param], known[param].default
        fields.append((own, hint) if default is NODEFAULT else (own, hint, default))
    fields.append(("unstick", Unstick, _unstick(document, kinds)))
    made = msgspec.defstruct(
        "MissionParams",
        fields,
        bases=(Params,),
        module=__name__,
        frozen=True,
        kw_only=True,
        forbid_unknown_fields=True,
    )
    return cast("type[Params]", made)


def _unstick(document: Document, kinds: Kinds) -> bool:
    """As the file says; else as those parts would have it that drive."""
    if document.unstick is not None or document.root is None:
        return bool(document.unstick)
    driving = {name: kinds[name] for name in drivers_of(document.root) if name in kinds}
    wishes = [
        document.parts[name].params.get("unstick", _default(kind, "unstick"))
        for name, kind in driving.items()
        if not issubclass(kind, VotingPattern)
    ]
    return bool(wishes) and all(wish is True for wish in wishes)


def _default(kind: type[Pattern[Any]], name: str) -> Any:
    return next(f.default for f in msgspec.structs.fields(kind.params_type) if f.name == name)


def _channels(document: Document, kinds: Kinds) -> dict[str, type]:
    """What the class says of channels before there is an object, which knows better."""
    found: dict[str, type] = {}
    for name, part in document.parts.items():
        prefix = f"{name}-" if part.is_private else f"{part.pattern}/"
        for channel, kind in dict(kinds[name].channels).items():
            found[channel if "/" in channel else prefix + channel] = kind
    return found
