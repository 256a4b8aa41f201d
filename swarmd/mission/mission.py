"""Runs a mission as a pattern: a class for each mission file, a node for each of its elements."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Collection, Mapping
from pathlib import Path
from typing import Any, ClassVar, TypeAlias, cast
from typing import get_type_hints as type_hints

import msgspec
from msgspec import NODEFAULT

from swarmd.core.errors import SwarmError, unknown
from swarmd.core.values import Inputs, Outputs, Platform, Scalar, Twist, Value
from swarmd.kit.behavior import Context, Pattern
from swarmd.kit.combined import CombinedPattern
from swarmd.kit.condition_state import ConditionState, Observation
from swarmd.kit.conditions import needs_of
from swarmd.kit.factory import Find
from swarmd.kit.params import Params, Recovery
from swarmd.kit.params import schema as params_schema
from swarmd.kit.voting_pattern import VotingPattern
from swarmd.mission import part_builder, schema
from swarmd.mission.document import Document, fault_error, read_document
from swarmd.settings.layered import fault_at

PatternClasses: TypeAlias = dict[str, type[Pattern[Any]]]


class Mission(CombinedPattern[Params]):
    """A pattern that a file composes of other patterns; each file has a class of its own."""

    document: ClassVar[Document]
    classes: ClassVar[PatternClasses]

    def __init__(self, params: Params, context: Context) -> None:
        super().__init__(params, context)
        assert self.document.root is not None
        self._root = _node(self.document.root)
        self._is_started = False
        self._reports: dict[str, Scalar] = {}
        self._done: set[str] = set()
        self._stepped: dict[str, Outputs] = {}

    @classmethod
    def defaults(cls, platform: Platform) -> Mapping[str, Value]:
        """The defaults of the mission's own parameters, on this platform.

        A default is the value of the part's parameter in the mission's file, else on the platform.
        """
        values_by_name: dict[str, Value] = {}
        for own, (name, param) in cls.document.parameters.items():
            part = cls.document.parts[name]
            kind = cls.classes[name]
            configured = platform.patterns.get(part.pattern, {})
            values = {**kind.defaults(platform), **configured, **part.params}
            if param in values:
                values_by_name[own] = values[param]
        return values_by_name

    def make_parts(self) -> Mapping[str, Pattern[Any]]:
        """Make all parts, and try every value of every map; ConfigError for the first fault."""
        builder = self._builder(self.params)
        parts = part_builder.build_parts(builder)
        self._setters = part_builder.build_setters(builder, parts)
        part_builder.check_reports(builder, parts)
        self._raise_first(builder)
        return parts

    def update(self, params: Params) -> None:
        """Hand changed parameters to the parts; ConfigError if a part refuses a value."""
        builder = self._builder(params)
        changes = {
            name: {k: v for k, v in values.items() if v != getattr(self.parts[name].params, k)}
            for name, values in builder.exposed.items()
        }
        changed = {
            name: part_builder.with_values(self.parts[name], values, "update")
            for name, values in changes.items()
            if values
        }
        opinions = {n: values["opinions"] for n, values in changes.items() if "opinions" in values}
        if opinions or any(setter.target[0] in changed for setter in self._setters):
            setters = part_builder.build_setters(builder, self.parts, opinions)
            self._raise_first(builder)
            self._setters = setters
        for name, values in changed.items():
            self.parts[name].update(values)
        super().update(params)

    def step(self, inputs: Inputs) -> Outputs:
        """One step of all parts of the present elements."""
        if not self._is_started:
            self._is_started = True
            self._root.start(inputs.now)
        seen = Observation(
            inputs.now,
            self._reports,
            self._done,
            inputs.scan,
            inputs.readings,
            inputs.neighbors,
            self.context.rng,
        )
        self._stepped = {}
        twist = None
        if not self._root.check(self, seen):
            twist = self._root.step(self, inputs, seen)
        messages: dict[str, Value] = {}
        grip = None
        for outputs in self._stepped.values():
            messages.update(outputs.messages)
            grip = outputs.grip if grip is None else grip
        return Outputs(twist, messages, self._report(), self._root.ended or None, grip)

    def run_part(self, name: str, inputs: Inputs) -> Outputs:
        """One step of a part; by the maps, its reports set parameters of other parts at once."""
        outputs = self._stepped[name] = self.step_part(name, inputs)
        self._reports.update({f"{name}.{key}": value for key, value in outputs.report.items()})
        (self._done.discard if outputs.done is None else self._done.add)(name)
        for setter in self._setters:
            source, key = setter.source
            if source == name and key in outputs.report:
                self._set(*setter.target, setter.table.get(outputs.report[key]))
        return outputs

    def forget(self, parts: Collection[str]) -> None:
        """Drop the reports of parts, so that no condition uses them until the next step."""
        for key in [key for key in self._reports if schema.split(key)[0] in parts]:
            del self._reports[key]
        self._done.difference_update(parts)

    def _builder(self, params: Params) -> part_builder.PartBuilder:
        exposed: dict[str, dict[str, Any]] = {}
        for own, (name, param) in self.document.parameters.items():
            exposed.setdefault(name, {})[param] = getattr(params, own)
        return part_builder.PartBuilder(self.document, self.context.make, exposed, [])

    def _raise_first(self, builder: part_builder.PartBuilder) -> None:
        if builder.faults:
            raise fault_error(self.document.path, builder.faults)

    def _set(self, name: str, param: str, value: Scalar | None) -> None:
        part = self.parts[name]
        if value is not None and value != getattr(part.params, param):
            part.update(msgspec.structs.replace(part.params, **{param: value}))

    def _report(self) -> Mapping[str, Scalar]:
        report: dict[str, Scalar] = {"phase": self._root.phase}
        for own, (name, key) in self.document.report.items():
            value = self._reports.get(f"{name}.{key}", getattr(self.parts[name].params, key, None))
            if value is not None:
                report[own] = value
        if not self.document.report:
            for name, outputs in self._stepped.items():
                report.update({f"{name}.{key}": value for key, value in outputs.report.items()})
        return report


def mission_class(path: Path, find: Find) -> type[Mission]:
    """Make the pattern class of a mission file, checked as far as possible without a robot.

    `find`: gives the class of a pattern by its name. ConfigError for the first fault of the file,
    with file and line.
    """
    document = read_document(path)
    # Both calls add faults to `document`.
    classes = pattern_classes(document, find)
    params_type = _params_type(document, classes)
    if document.faults or document.root is None:
        raise fault_error(path, document.faults)
    needs = frozenset[str]().union(*(kind.needs for kind in classes.values()))
    for _, condition in schema.conditions(document.root):
        needs |= needs_of(condition)
    members = {
        "__doc__": document.description,
        "__module__": __name__,
        "document": document,
        "classes": classes,
        "params_type": params_type,
        "needs": needs,
        "channels": _channels(document, classes),
        "rate": max(kind.rate for kind in classes.values()),
        "report_units": _report_units(document, classes),
    }
    return type(f"Mission_{path.stem}", (Mission,), members)


def pattern_classes(document: Document, find: Find) -> PatternClasses:
    """The class of each part; adds a fault for each pattern that cannot be loaded."""
    classes: PatternClasses = {}
    for name, part in document.parts.items():
        try:
            classes[name] = find(part.pattern)
        except SwarmError as error:
            text = f"names {error}"
            document.faults.append(fault_at(("parts", name, "pattern"), text))
        except (Exception, SystemExit) as error:  # a plugin may raise anything
            text = f"cannot be loaded: {part_builder.error_text(error)}"
            document.faults.append(fault_at(("parts", name, "pattern"), text))
    return classes


def _report_units(document: Document, classes: PatternClasses) -> dict[str, str]:
    """The units of the mission's reports, by the declarations of its parts."""
    units: dict[str, str] = {}
    for name, kind in classes.items():
        units |= {f"{name}.{key}": unit for key, unit in kind.report_units.items()}
    if not document.report:
        return units
    for name, kind in classes.items():  # a mission may report parameters of its parts
        params = {f"{name}.{spec.name}": spec.unit for spec in params_schema(kind.params_type)}
        units = params | units
    reported = {own: units.get(".".join(at), "") for own, at in document.report.items()}
    return {own: unit for own, unit in reported.items() if unit}


def _params_type(document: Document, classes: PatternClasses) -> type[Params]:
    """The class of the mission's parameters: those of its file, and `recovery`.

    Each parameter of the mission sets a parameter of a part, and has the type, bounds and default
    of that parameter. Adds a fault to `document` for a parameter that the part's pattern does not
    have. `classes`: the pattern class of each part; a part without a class is skipped.
    """
    fields: list[Any] = []  # (name, type), or (name, type, default)
    for own_name, (part, part_parameter) in document.parameters.items():
        if part not in classes:
            continue
        params_of_part = classes[part].params_type
        field_of = {field.name: field for field in msgspec.structs.fields(params_of_part)}
        if part_parameter not in field_of:
            pattern = document.parts[part].pattern
            text = f"names {unknown('parameter', part_parameter, field_of)} (of {pattern})"
            document.faults.append(fault_at(("parameters", own_name), text))
            continue
        # The hint includes the bounds.
        hint = type_hints(params_of_part, include_extras=True)[part_parameter]
        default = field_of[part_parameter].default
        is_required = default is NODEFAULT
        fields.append((own_name, hint) if is_required else (own_name, hint, default))
    fields.append(("recovery", Recovery, _recovery(document, classes)))
    params_type = msgspec.defstruct(
        "MissionParams",
        fields,
        bases=(Params,),
        module=__name__,
        frozen=True,
        kw_only=True,
        forbid_unknown_fields=True,
    )
    return cast("type[Params]", params_type)


def _recovery(document: Document, classes: PatternClasses) -> bool:
    """The file's `recovery`; without this key, True if all driving parts have recovery on."""
    if document.recovery is not None or document.root is None:
        return bool(document.recovery)
    values = [
        document.parts[name].params.get("recovery", _default(classes[name], "recovery"))
        for name in set(schema.driving_parts(document.root)) & set(classes)
        if not issubclass(classes[name], VotingPattern)
    ]
    return bool(values) and all(value is True for value in values)


def _default(kind: type[Pattern[Any]], name: str) -> Any:
    return next(f.default for f in msgspec.structs.fields(kind.params_type) if f.name == name)


def _channels(document: Document, classes: PatternClasses) -> dict[str, type]:
    """The channels that the classes of the parts declare; a Mission object has the exact ones."""
    channels: dict[str, type] = {}
    for name, part in document.parts.items():
        prefix = f"{name}-" if part.private else f"{part.pattern}/"
        for channel, kind in dict(classes[name].channels).items():
            channels[channel if "/" in channel else prefix + channel] = kind
    return channels


_FAILED = "failed: "


class _Node(ABC):
    """Runs one element of a mission; has the state of the element."""

    def __init__(self, element: schema.Element) -> None:
        self.name = element.label
        self.ended = ""  # the reason why the element has ended, empty before
        self.has_failed = False  # the element has ended by a failure
        self._is_new = True  # the element has not been checked since its start
        self._until = None if element.until is None else ConditionState(element.until)
        self._fails = None if element.fails is None else ConditionState(element.fails)
        self._transitions = [
            (name, ConditionState(condition))
            for name, condition in (element.transitions or {}).items()
        ]
        self.target: str | None = None  # the next step by a transition whose condition holds
        self._retry = element.retry or 0
        self._retries = 0
        self._parts = frozenset(schema.parts_in(element))

    def start(self, now: float) -> None:
        """Start, or start again from the beginning."""
        self._retries = 0
        self._begin(now)

    def _begin(self, now: float) -> None:
        self.ended = ""
        self.has_failed = False
        self._is_new = True
        self.target = None
        for condition in (self._until, self._fails, *(state for _, state in self._transitions)):
            if condition is not None:
                condition.start(now)

    def check(self, mission: Mission, seen: Observation) -> str:
        """Evaluate the conditions once before each step; returns why the element ended, or "".

        1. An element never ends before its first step: the reports of its parts would be old.
        2. If several conditions hold, `until` counts before `fails`, and `fails` before the
           transitions.
        3. The first transition whose condition holds sets `target`. The element itself does not
           end: the sequence around it starts the step `target` in its place.
        """
        is_new = self._is_new
        self._is_new = False
        if not self.ended:
            until = self._until
            fails = self._fails
            # Every condition has a memory, and so must be evaluated at every step.
            targets = [name for name, state in self._transitions if state.is_met(seen)]
            is_over = until is not None and until.is_met(seen) and not is_new
            is_lost = fails is not None and fails.is_met(seen) and not is_new
            if until is not None and is_over:
                self.ended = str(until.condition)
            elif fails is not None and is_lost:
                self._fail(str(fails.condition), mission, seen.now)
                self._is_new = False  # this check counts as the first of a retry
            elif targets and not is_new:
                self.target = targets[0]
        return self.ended

    def _fail(self, reason: str, mission: Mission, now: float) -> None:
        """Fail for a reason; or, while `retry` permits, restart without the parts' reports."""
        if self._retries < self._retry:
            self._retries += 1
            mission.forget(self._parts)
            self._begin(now)
        else:
            prefix = "" if reason.startswith(_FAILED) else _FAILED
            self.ended = prefix + reason
            self.has_failed = True

    def _end_like(self, child: _Node, mission: Mission, now: float) -> None:
        """End as the child has ended, or fail as the child has failed."""
        if child.has_failed:
            self._fail(child.ended, mission, now)
        else:
            self.ended = child.ended

    @abstractmethod
    def step(self, mission: Mission, inputs: Inputs, seen: Observation) -> Twist | None:
        """One step of the element's parts; returns the command of the driving part."""

    @property
    @abstractmethod
    def phase(self) -> str:
        """The names of the present elements, outermost first."""


class _RunNode(_Node):
    def __init__(self, element: schema.RunPart) -> None:
        super().__init__(element)
        self._part = element.part

    def step(self, mission: Mission, inputs: Inputs, seen: Observation) -> Twist | None:
        outputs = mission.run_part(self._part, inputs)
        if outputs.done is not None:
            self.ended = f"{self._part}: {outputs.done}"
        return outputs.twist

    @property
    def phase(self) -> str:
        return self.name


class _SequenceNode(_Node):
    """Runs a sequence or a fallback.

    A sequence starts the next step when a step ends, a fallback starts the next item when an item
    fails. If a transition of the present step holds, the step that the transition names starts.
    """

    def __init__(self, element: schema.Sequence | schema.Fallback) -> None:
        super().__init__(element)
        self._steps = [_node(step) for step in element.children]
        self._is_fallback = isinstance(element, schema.Fallback)
        self._repeats = isinstance(element, schema.Sequence) and element.then == "repeat"
        self._index = 0

    def _begin(self, now: float) -> None:
        super()._begin(now)
        self._index = 0
        self._steps[0].start(now)

    def step(self, mission: Mission, inputs: Inputs, seen: Observation) -> Twist | None:
        current = self._steps[self._index]
        if current.check(mission, seen):
            if self._is_last(current):
                self._end_like(current, mission, seen.now)
                return None
            current = self._enter((self._index + 1) % len(self._steps), mission, seen)
        elif current.target is not None:
            names = [step.name for step in self._steps]
            current = self._enter(names.index(current.target), mission, seen)
        twist = current.step(mission, inputs, seen)
        if current.ended and self._is_last(current):
            self._end_like(current, mission, seen.now)
        return twist

    def _enter(self, index: int, mission: Mission, seen: Observation) -> _Node:
        self._index = index
        current = self._steps[index]
        current.start(seen.now)
        current.check(mission, seen)
        return current

    def _is_last(self, current: _Node) -> bool:
        """Whether no step follows the current step, which has ended."""
        is_final = self._index == len(self._steps) - 1 and not self._repeats
        return is_final or current.has_failed != self._is_fallback

    @property
    def phase(self) -> str:
        return _joined(self.name, self._steps[self._index].phase)


class _ParallelNode(_Node):
    def __init__(self, element: schema.Parallel) -> None:
        super().__init__(element)
        self._items = [_node(child) for child in element.children]
        self._driver = element.drives

    def _begin(self, now: float) -> None:
        super()._begin(now)
        for item in self._items:
            item.start(now)

    def step(self, mission: Mission, inputs: Inputs, seen: Observation) -> Twist | None:
        requested = None
        for item in self._items:
            if item.check(mission, seen):
                continue
            twist = item.step(mission, inputs, seen)
            if item.name == self._driver:
                requested = twist
        failed = next((item for item in self._items if item.has_failed), None)
        if failed is not None:
            self._fail(failed.ended, mission, seen.now)
        elif all(item.ended for item in self._items):
            self.ended = "; ".join(item.ended for item in self._items)
        return requested

    @property
    def phase(self) -> str:
        return self.name or "+".join(item.phase for item in self._items if not item.ended)


class _SwitchNode(_Node):
    def __init__(self, element: schema.Switch) -> None:
        super().__init__(element)
        self._branches = [
            (None if child.when is None else ConditionState(child.when), _node(child))
            for child in element.children
        ]
        self._chosen: _Node | None = None

    def _begin(self, now: float) -> None:
        super()._begin(now)
        self._chosen = None
        for when, _ in self._branches:
            if when is not None:
                when.start(now)

    def step(self, mission: Mission, inputs: Inputs, seen: Observation) -> Twist | None:
        # A list, not a generator: every condition must be evaluated at every step for its memory.
        met = [node for when, node in self._branches if when is None or when.is_met(seen)]
        chosen = met[0] if met else None
        if chosen is not self._chosen:
            self._chosen = chosen
            if chosen is not None:
                chosen.start(seen.now)
        if chosen is None or chosen.check(mission, seen):
            if chosen is not None and chosen.has_failed:
                self._fail(chosen.ended, mission, seen.now)
            return None
        return chosen.step(mission, inputs, seen)

    @property
    def phase(self) -> str:
        return _joined(self.name, "" if self._chosen is None else self._chosen.phase)


def _node(element: schema.Element) -> _Node:
    match element:
        case schema.RunPart():
            return _RunNode(element)
        case schema.Sequence() | schema.Fallback():
            return _SequenceNode(element)
        case schema.Parallel():
            return _ParallelNode(element)
        case schema.Switch():
            return _SwitchNode(element)


def _joined(*names: str) -> str:
    return "/".join(name for name in names if name)
