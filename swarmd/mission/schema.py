"""The file of a mission as tagged structs, and what can be checked in it without its patterns.

An element is a RunPart, Sequence, Parallel, Switch or Fallback; the key that names its kind
(`part`, `sequence`, `parallel`, `switch`, `fallback`) is the tag. `swarmd.mission.validate` checks
what needs the patterns.
"""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Collection, Iterable, Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Any, Literal, TypeAlias

import msgspec
from msgspec import Meta, Struct

from swarmd.core.bounds import BoundedScalar
from swarmd.core.errors import ConfigError, unknown
from swarmd.core.keys import is_id
from swarmd.kit.conditions import Condition, Done, Not, Reported, Settled, is_drawn
from swarmd.settings.layered import Fault, Keys, fault_at, read
from swarmd.settings.yamlfile import key_lines, shown
from swarmd.settings.yamlfile import read as read_yaml

NO_DRIVER = "none"
"""The value of `drives` of a parallel in which no part drives."""

_PARAMETER_NAME = re.compile(r"[A-Za-z][A-Za-z0-9_]*")
_RESERVED_PARTS = (NO_DRIVER, "phase")
_RESERVED_NAMES = ("recovery", "avoidance", "phase")
_RECOVERY = "sets recovery, which is of the whole mission: set it beside parts, or -p recovery="
_AVOIDANCE = "sets avoidance, which is of the whole mission: give it by -p avoidance="
_DRAWN = (
    "is drawn anew at each step; give it to until, fails or transitions, there alone or in any or"
    " all"
)
_TRANSITIONS = "belongs to a step of a sequence; leave it out"
_SHARED = {"recovery": _RECOVERY, "avoidance": _AVOIDANCE}

Number = Annotated[float, Meta(ge=-1e9, le=1e9)]
Elements: TypeAlias = "Annotated[tuple[Element, ...], Meta(min_length=1)]"
Reference: TypeAlias = tuple[str, str]
"""A part, and one of its reports or parameters."""


class ElementBase(Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """The keys of every element."""

    name: str = ""
    until: Condition | None = None  # ends the element
    fails: Condition | None = None  # makes the element fail
    retry: Annotated[int, Meta(ge=1, le=1000)] | None = None  # failures that begin it again instead
    when: Condition | None = None  # only in a branch of a switch
    # Only in a step of a sequence: the name of the next step by the condition that leads there. The
    # first condition that holds counts, in the order of the file.
    transitions: Annotated[dict[str, Condition], Meta(min_length=1)] | None = None

    @property
    def label(self) -> str:
        """The name of the element in `drives` and `phase`."""
        return self.name


class RunPart(ElementBase, frozen=True, tag="part"):
    """Steps one part, which drives."""

    part: Annotated[str, Meta(min_length=1, description="the name of a part")]

    @property
    def label(self) -> str:
        """Its name, by default that of its part."""
        return self.name or self.part

    @property
    def children(self) -> tuple[Element, ...]:
        """It holds no other element."""
        return ()


class Sequence(ElementBase, frozen=True, tag="sequence"):
    """Runs its steps one after the other; `then` says what follows the last."""

    children: Elements = msgspec.field(name="sequence")
    then: Literal["end", "stay", "repeat"]


class Parallel(ElementBase, frozen=True, tag="parallel"):
    """Runs its items at once; the item with label `drives` drives, or no item."""

    children: Elements = msgspec.field(name="parallel")
    drives: Annotated[str, Meta(description=f"the name of an item, or {NO_DRIVER}")]


class Switch(ElementBase, frozen=True, tag="switch"):
    """Runs the first branch whose `when` holds; the last may be without."""

    children: Elements = msgspec.field(name="switch")


class Fallback(ElementBase, frozen=True, tag="fallback"):
    """Runs its first item, and the next one where an item fails."""

    children: Elements = msgspec.field(name="fallback")


Element: TypeAlias = RunPart | Sequence | Parallel | Switch | Fallback
_KINDS = ("sequence", "parallel", "switch", "fallback")


class Part(Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """A pattern with its parameters; `private`: only robots of this mission hear its messages."""

    pattern: Annotated[str, Meta(min_length=1, description="the name of a pattern")]
    params: dict[str, BoundedScalar | None] = {}
    private: bool = False


class Map(Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Sets a parameter (`to`) by a report of another part (`from`).

    `values` lists the value for report 0, 1, 2 ..., or gives it by reported text. Instead, `base` +
    `step` times the reported number: for `count` of them, by default all opinions of a vote.
    """

    source: str = msgspec.field(name="from")
    target: str = msgspec.field(name="to")
    values: Annotated[list[BoundedScalar] | dict[str, BoundedScalar], Meta(min_length=1)] | None = (
        None
    )
    base: Number | None = None
    step: Number | None = None
    count: Annotated[int, Meta(ge=1, le=1000)] | None = None


class MissionFile(Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """The keys of a mission's file beside those of its outermost element.

    `report` and `parameters` give names of the mission's own to PART.KEY and PART.PARAMETER.
    """

    mission: str = ""
    parts: dict[str, Part] = {}
    map: list[Map] = []
    report: dict[str, str] = {}
    parameters: dict[str, str] = {}
    recovery: bool | None = None


@dataclass(slots=True)
class Document:
    """The contents of a mission's file, without the faulty parts, which `faults` lists."""

    path: Path
    description: str
    parts: dict[str, Part]
    names: Collection[str]  # of all parts, the faulty ones included
    maps: list[tuple[Keys, Map]]  # each with its place in the file
    report: Mapping[str, Reference]
    parameters: Mapping[str, Reference]
    recovery: bool | None
    root: Element | None  # None if any element is faulty
    faults: list[Fault] = field(default_factory=list)


def fault_lines(path: Path, faults: Iterable[Fault]) -> list[str]:
    """A line for each fault, in the order of the file: file, line, key, what is wrong."""
    lines = key_lines(path)
    rows = [
        (next((lines[keys[:n]] for n in range(len(keys), 0, -1) if keys[:n] in lines), 1), text)
        for keys, text in faults
    ]
    ordered = sorted(rows, key=lambda row: row[0])
    return [f"{shown(path)}:{line}: {text}" for line, text in ordered]


def fault_error(path: Path, faults: Iterable[Fault]) -> ConfigError:
    """The error for the first fault; it says how many more there are."""
    first, *more = fault_lines(path, faults)
    rest = f" (and {len(more)} more; swarmctl mission check shows all)" if more else ""
    return ConfigError(first + rest)


def read_document(path: Path) -> Document:
    """The mission of a file, with its faults; ConfigError if the file is not YAML."""
    data = read_yaml(path)
    own = {key: data[key] for key in MissionFile.__struct_fields__ if key in data}
    rest = {key: value for key, value in data.items() if key not in own}
    names = list(data["parts"]) if isinstance(data.get("parts"), dict) else []
    maps: list[tuple[Keys, Map]] = []

    def check(value: Any, keys: Keys) -> Iterator[Fault]:
        value_faults = list(_check(value, keys, names))
        if isinstance(value, Map) and not value_faults:
            maps.append((keys, value))
        yield from value_faults

    file, faults = read(own, MissionFile, check)
    expanded = _expanded(rest)
    root, root_faults = read(expanded, Element, check)
    root_faults += _check_names(expanded, (), names)
    document = Document(
        path=path,
        description=file.mission,
        parts={name: part for name, part in file.parts.items() if _is_part_name(name)},
        names=names,
        maps=maps,
        report=dict(_named("report", file.report, names, faults)),
        parameters=dict(_named("parameters", file.parameters, names, faults)),
        recovery=file.recovery,
        root=None if root_faults else root,
        faults=faults + root_faults,
    )
    document.faults += _check_whole(document, data)
    return document


def split(reference: str) -> Reference:
    """The part and the key of PART.KEY."""
    part, _, key = reference.partition(".")
    return part, key


def elements(root: Element | None, keys: Keys = ()) -> Iterator[tuple[Keys, Element]]:
    """An element and all elements in it, each with its place."""
    if root is None:
        return
    yield keys, root
    for index, child in enumerate(root.children):
        yield from elements(child, (*keys, _tag(root), index))


def conditions(root: Element | None) -> Iterator[tuple[Keys, Condition]]:
    """All conditions of an element and of the elements in it, each with its place."""
    for keys, element in elements(root):
        for key in ("until", "fails", "when"):
            condition: Condition | None = getattr(element, key)
            if condition is not None:
                yield (*keys, key), condition
        for name, condition in (element.transitions or {}).items():
            yield (*keys, "transitions", name), condition


def parts_in(element: Element) -> set[str]:
    """The parts that an element steps."""
    return {leaf.part for _, leaf in elements(element) if isinstance(leaf, RunPart)}


def driving_parts(element: Element) -> Iterator[str]:
    """The parts that may drive."""
    if isinstance(element, RunPart):
        yield element.part
    for child in element.children:
        if not isinstance(element, Parallel) or child.label == element.drives:
            yield from driving_parts(child)


def report_of(condition: Condition) -> str | None:
    """The report that a simple condition reads, as PART.KEY; None if it reads no report."""
    match condition:
        case Settled(report=name) | Reported(name=name):
            return name
        case _:
            return None


def _expanded(element: Any) -> Any:
    """The data of an element in which `{part: NAME}` replaces the short form NAME."""
    if isinstance(element, str):
        return {"part": element}
    if not isinstance(element, dict):
        return element
    return {
        key: [_expanded(child) for child in value]
        if key in _KINDS and isinstance(value, list)
        else value
        for key, value in element.items()
    }


def _tag(element: Element) -> str:
    return str(element.__struct_config__.tag)


def _is_part_name(name: str) -> bool:
    return is_id(name) and name not in _RESERVED_PARTS


def _can_end(element: Element) -> bool:
    """Whether an element can end: by its condition, or because its last items can end."""
    if element.until is not None:
        return True
    if isinstance(element, Sequence):
        return element.then == "end"
    if isinstance(element, Fallback):
        return any(map(_can_end, element.children))
    return isinstance(element, Parallel) and all(map(_can_end, element.children))


def _can_fail(element: Element) -> bool:
    """Whether an element can fail: by its condition, or because its items can fail."""
    if element.fails is not None:
        return True
    if isinstance(element, Fallback):
        return all(map(_can_fail, element.children))
    return any(map(_can_fail, element.children))


def _check(value: Any, keys: Keys, names: Collection[str]) -> Iterator[Fault]:
    """Faults that the types of a struct cannot express."""
    if isinstance(value, Element) and value.retry is not None and not _can_fail(value):
        yield fault_at((*keys, "retry"), "never counts, as nothing fails; give it a fails")
    match value:
        case Sequence():
            yield from _check_sequence(value, keys)
        case Parallel():
            yield from _check_parallel(value, keys)
        case Switch():
            for index, branch in enumerate(value.children[:-1]):
                if branch.when is None:
                    text = "is missing; only the last branch may go without a condition"
                    yield fault_at((*keys, "switch", index, "when"), text)
            for index, branch in enumerate(value.children):
                if branch.when is not None and is_drawn(branch.when):
                    yield fault_at((*keys, "switch", index, "when"), _DRAWN)
        case Fallback():
            for index, item in enumerate(value.children[:-1]):
                if not _can_fail(item):
                    text = "never fails, and more items follow; give it a fails"
                    yield fault_at((*keys, "fallback", index), text)
        case Not() if is_drawn(value.condition):
            yield fault_at((*keys, "not"), _DRAWN)
        case Done():
            yield from _check_part(value.part, (*keys, "done"), names)
        case Settled() | Reported():
            key = str(value.__struct_config__.tag)
            yield from _check_reference(report_of(value) or "", (*keys, key), names)
        case Map():
            yield from _check_map(value, keys, names)
        case _:
            pass
    if isinstance(value, Sequence | Parallel | Fallback):
        for index, child in enumerate(value.children):
            if child.when is not None:
                text = "belongs to a branch of a switch; take until, or leave it out"
                yield fault_at((*keys, _tag(value), index, "when"), text)
    if isinstance(value, Element) and not isinstance(value, RunPart | Sequence):
        for index, child in enumerate(value.children):
            if child.transitions is not None:
                yield fault_at((*keys, _tag(value), index, "transitions"), _TRANSITIONS)


def _check_names(element: Any, keys: Keys, names: Collection[str]) -> Iterator[Fault]:
    """Unknown parts and steps in the data of an element, which may have other faults."""
    if not isinstance(element, dict):
        return
    if element.get("part") and isinstance(element["part"], str):
        yield from _check_part(element["part"], (*keys, "part"), names)
    for kind in _KINDS:
        children = element.get(kind)
        if not isinstance(children, list):
            continue
        if kind == "sequence":
            yield from _check_transitions(children, (*keys, kind))
        for index, child in enumerate(children):
            yield from _check_names(child, (*keys, kind, index), names)


def _check_transitions(steps: list[Any], keys: Keys) -> Iterator[Fault]:
    sections = [step if isinstance(step, dict) else {} for step in steps]
    labels = [section.get("name") or section.get("part") or "" for section in sections]
    named = Counter(map(str, labels))
    for index, step in enumerate(sections):
        transitions = step.get("transitions")
        for name in transitions if isinstance(transitions, dict) else ():
            where = (*keys, index, "transitions", name)
            if named[name] > 1:
                text = f"is {name}, the name of two steps; give each a name of its own"
                yield fault_at(where, text)
            elif name not in named or not name:
                yield fault_at(where, f"names {unknown('step', name, filter(None, named))}")


def _check_sequence(sequence: Sequence, keys: Keys) -> Iterator[Fault]:
    *before, last = sequence.children
    place = (*keys, "sequence", len(before))
    for index in sorted({*range(len(sequence.children))} - _reached(sequence)):
        text = "is never reached; name it in a transition, or give the step before it an until"
        yield fault_at((*keys, "sequence", index), text)
    for index, step in enumerate(before):
        if not _can_end(step) and step.transitions is None:
            text = "never ends, and more steps follow; give it an until"
            yield fault_at((*keys, "sequence", index), text)
    if sequence.then == "stay" and last.until is not None:
        text = "is the until of the last step, and then is stay; leave it out, or take end"
        yield fault_at((*place, "until"), text)
    is_left = last.transitions is not None and sequence.then == "repeat"
    if sequence.then != "stay" and not _can_end(last) and not is_left:
        text = f"never ends, and then is {sequence.then}; give it an until, or take stay"
        yield fault_at(place, text)


def _reached(sequence: Sequence) -> set[int]:
    """The indices of the steps that the sequence can reach, if each transition can hold.

    A step without an end and without transitions has a fault of its own: the step after it counts
    as reached.
    """
    steps = sequence.children
    indices = {step.label: index for index, step in enumerate(steps)}
    reached: set[int] = set()
    todo = [0]
    while todo:
        index = todo.pop()
        if index in reached or index == len(steps):
            continue
        reached.add(index)
        targets = steps[index].transitions
        if _can_end(steps[index]) or targets is None:
            todo.append(index + 1)
        todo += [indices[name] for name in targets or () if name in indices]
    return reached


def _check_parallel(parallel: Parallel, keys: Keys) -> Iterator[Fault]:
    labels = [child.label for child in parallel.children]
    used = [part for child in parallel.children for part in parts_in(child)]
    for part in sorted({part for part in used if used.count(part) > 1}):
        yield fault_at(keys, f"steps part {part} twice at once; name it once, or make two parts")
    drives = parallel.drives
    if labels.count(drives) > 1:
        text = f"is {drives}, the name of two items; give each a name of its own"
        yield fault_at((*keys, "drives"), text)
    elif drives not in (*labels, NO_DRIVER):
        text = f"names {unknown('item', drives, filter(None, labels))} (or {NO_DRIVER})"
        yield fault_at((*keys, "drives"), text)


def _check_map(mapping: Map, keys: Keys, names: Collection[str]) -> Iterator[Fault]:
    yield from _check_reference(mapping.source, (*keys, "from"), names)
    yield from _check_reference(mapping.target, (*keys, "to"), names)
    (source, _), (target, param) = split(mapping.source), split(mapping.target)
    if param in _SHARED:
        yield fault_at((*keys, "to"), _SHARED[param])
    if source == target:
        yield fault_at((*keys, "to"), f"is a parameter of {source} itself; expected another part's")
    if (mapping.values is None) == (mapping.base is None):
        yield fault_at(keys, "needs either values, or base and step")
    elif mapping.base is not None and mapping.step is None:
        yield fault_at((*keys, "step"), "is missing; expected a number, as base is there")
    elif mapping.base is None and (mapping.step, mapping.count) != (None, None):
        yield fault_at(keys, "has step or count, which go with base, beside values")


def _check_part(part: str, keys: Keys, names: Collection[str]) -> Iterator[Fault]:
    if part not in names:
        yield fault_at(keys, f"names {unknown('part', part, names)}")


def _check_reference(reference: str, keys: Keys, names: Collection[str]) -> Iterator[Fault]:
    part, key = split(reference)
    if not key:
        yield fault_at(keys, f"is {reference!r}; expected PART.KEY, such as vote.opinion")
    else:
        yield from _check_part(part, keys, names)


def _named(
    key: str, references: Mapping[str, str], names: Collection[str], faults: list[Fault]
) -> Iterator[tuple[str, Reference]]:
    """The valid entries of `report` or `parameters`; the faults of the others are appended."""
    for own, reference in references.items():
        wrong = list(_check_reference(reference, (key, own), names))
        if not _PARAMETER_NAME.fullmatch(own) or own in _RESERVED_NAMES:
            text = (
                "is not a valid name; expected letters, digits and _, but not recovery, avoidance"
                " or phase"
            )
            wrong = [fault_at((key, own), text)]
        faults += wrong
        if not wrong:
            yield own, split(reference)


def _check_whole(document: Document, data: Mapping[str, Any]) -> Iterator[Fault]:
    """Faults between the keys of the file."""
    if "mission" not in data:
        yield fault_at(("mission",), "is missing; expected a line that says what the mission does")
    if not data.get("parts"):
        yield fault_at(("parts",), "is missing; expected parts, such as move: {pattern: NAME}")
    if document.root is not None and document.root.when is not None:
        yield fault_at(("when",), "belongs to a branch of a switch; leave it out")
    if document.root is not None and document.root.transitions is not None:
        yield fault_at(("transitions",), _TRANSITIONS)
    used = set(document.names) if document.root is None else parts_in(document.root)
    for name in document.names:
        if not _is_part_name(name):
            text = f"is not a valid name of a part; expected letters, digits and _, not {NO_DRIVER}"
            yield fault_at(("parts", name), text)
        elif name not in used:
            yield fault_at(("parts", name), "is never stepped; name it in a step, or leave it out")
        elif "avoidance" in (document.parts[name].params if name in document.parts else ()):
            yield fault_at(("parts", name, "params", "avoidance"), _AVOIDANCE)
    setters: dict[Reference, str] = {}
    for keys, entry in document.maps:
        if split(entry.target) in setters:
            yield fault_at((*keys, "to"), f"is {entry.target}, which another map sets; keep one")
        setters[split(entry.target)] = "a map"
    for own, reference in document.parameters.items():
        if reference[1] in _SHARED:
            yield fault_at(("parameters", own), _SHARED[reference[1]])
        if reference in setters:
            text = f"is {'.'.join(reference)}, which {setters[reference]} sets too; keep one"
            yield fault_at(("parameters", own), text)
        setters.setdefault(reference, own)
