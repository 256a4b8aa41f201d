"""What the elements of a mission do, step by step.

Missions as patterns: a class for each file.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, ClassVar, Protocol, TypeAlias, cast
from typing import get_type_hints as type_hints

import msgspec
from msgspec import NODEFAULT

from swarmd.core.errors import SwarmError
from swarmd.core.values import Inputs, Outputs, Platform, Twist, Value
from swarmd.kit.behavior import Context, Pattern
from swarmd.kit.combined import CombinedPattern
from swarmd.kit.condition_state import Facts, Watch
from swarmd.kit.conditions import Scalar, needs_of
from swarmd.kit.diagnostics import Faults
from swarmd.kit.params import Params, Recovery
from swarmd.kit.voting_pattern import VotingPattern
from swarmd.mission.schema import (
    Document,
    Element,
    Parallel,
    Run,
    Sequence,
    Switch,
    conditions_of,
    drivers_of,
    read_document,
    refusal,
)
from swarmd.mission.validate import (
    Company,
    make_company,
    tables_of,
    trial_of,
    with_values,
    words_of,
)


class Stepper(Protocol):
    """Steps parts by name."""

    def run_part(self, name: str, inputs: Inputs) -> Outputs:
        """One step of a part."""


class Node(ABC):
    """One element. `over` says why it has ended; empty while it goes on."""

    def __init__(self, element: Element) -> None:
        self.name = element.name
        self.over = ""
        self._is_new = True
        self._watch = None if element.until is None else Watch(element.until)

    def begin(self, now: float) -> None:
        """It starts, or starts anew."""
        self.over = ""
        self._is_new = True
        if self._watch is not None:
            self._watch.begin(now)

    def check(self, facts: Facts) -> str:
        """Why it has ended, also by its own condition; to be asked before each step.

        Before its first step it has not: what its parts last reported is from another time.
        """
        is_new, self._is_new = self._is_new, False
        if self._watch is not None and not self.over and self._watch.is_met(facts) and not is_new:
            self.over = str(self._watch.condition)
        return self.over

    @abstractmethod
    def step(self, stepper: Stepper, inputs: Inputs, facts: Facts) -> Twist | None:
        """One step of all that is in it now; what its driver wants."""

    @property
    @abstractmethod
    def phase(self) -> str:
        """What it is at, in words."""


class _Run(Node):
    def __init__(self, element: Run) -> None:
        super().__init__(element)
        self._part = element.part

    def step(self, stepper: Stepper, inputs: Inputs, facts: Facts) -> Twist | None:
        outputs = stepper.run_part(self._part, inputs)
        if outputs.done is not None:
            self.over = f"{self._part}: {outputs.done}"
        return outputs.twist

    @property
    def phase(self) -> str:
        return self.name


class _Sequence(Node):
    def __init__(self, element: Sequence) -> None:
        super().__init__(element)
        self._steps = [node_of(step) for step in element.steps]
        self._then = element.then
        self._index = 0

    def begin(self, now: float) -> None:
        super().begin(now)
        self._index = 0
        self._steps[0].begin(now)

    def step(self, stepper: Stepper, inputs: Inputs, facts: Facts) -> Twist | None:
        if self._steps[self._index].check(facts):
            if not self._advance(facts.now):
                return None
            self._steps[self._index].check(facts)  # its first, which ends nothing
        current = self._steps[self._index]
        twist = current.step(stepper, inputs, facts)
        if current.over and self._is_last and self._then != "repeat":
            self.over = current.over
        return twist

    def _advance(self, now: float) -> bool:
        if self._is_last and self._then != "repeat":
            self.over = self._steps[self._index].over
            return False
        self._index = (self._index + 1) % len(self._steps)
        self._steps[self._index].begin(now)
        return True

    @property
    def _is_last(self) -> bool:
        return self._index == len(self._steps) - 1

    @property
    def phase(self) -> str:
        return _joined(self.name, self._steps[self._index].phase)


class _Parallel(Node):
    def __init__(self, element: Parallel) -> None:
        super().__init__(element)
        self._items = [node_of(item) for item in element.items]
        self._driver = element.driver

    def begin(self, now: float) -> None:
        super().begin(now)
        for item in self._items:
            item.begin(now)

    def step(self, stepper: Stepper, inputs: Inputs, facts: Facts) -> Twist | None:
        requested = None
        for index, item in enumerate(self._items):
            if item.check(facts):
                continue
            twist = item.step(stepper, inputs, facts)
            if index == self._driver:
                requested = twist
        if all(item.over for item in self._items):
            self.over = "; ".join(item.over for item in self._items)
        return requested

    @property
    def phase(self) -> str:
        return self.name or "+".join(item.phase for item in self._items if not item.over)


class _Switch(Node):
    def __init__(self, element: Switch) -> None:
        super().__init__(element)
        self._branches = [
            (None if when is None else Watch(when), node_of(inner))
            for when, inner in element.branches
        ]
        self._chosen: Node | None = None

    def begin(self, now: float) -> None:
        super().begin(now)
        self._chosen = None
        for watch, _ in self._branches:
            if watch is not None:
                watch.begin(now)

    def step(self, stepper: Stepper, inputs: Inputs, facts: Facts) -> Twist | None:
        # All are asked each time: what they remember must not depend on the others.
        holds = [watch is None or watch.is_met(facts) for watch, _ in self._branches]
        chosen = next(
            (n for is_so, (_, n) in zip(holds, self._branches, strict=True) if is_so), None
        )
        if chosen is not self._chosen:
            self._chosen = chosen
            if chosen is not None:
                chosen.begin(facts.now)
        if chosen is None or chosen.check(facts):
            return None
        return chosen.step(stepper, inputs, facts)

    @property
    def phase(self) -> str:
        return _joined(self.name, "" if self._chosen is None else self._chosen.phase)


def node_of(element: Element) -> Node:
    """The node that carries an element out."""
    if isinstance(element, Run):
        return _Run(element)
    if isinstance(element, Sequence):
        return _Sequence(element)
    return _Parallel(element) if isinstance(element, Parallel) else _Switch(element)


def _joined(*names: str) -> str:
    return "/".join(name for name in names if name)


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
    fields.append(("recovery", Recovery, _recovery(document, kinds)))
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


def _recovery(document: Document, kinds: Kinds) -> bool:
    """As the file says; else as those parts would have it that drive."""
    if document.recovery is not None or document.root is None:
        return bool(document.recovery)
    driving = {name: kinds[name] for name in drivers_of(document.root) if name in kinds}
    requested_commands = [
        document.parts[name].params.get("recovery", _default(kind, "recovery"))
        for name, kind in driving.items()
        if not issubclass(kind, VotingPattern)
    ]
    return bool(requested_commands) and all(requested is True for requested in requested_commands)


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
