"""Checks of a mission's file that need no patterns: names, references, ends and transitions.

`part_builder.py` has the checks that need the patterns.
"""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Collection, Iterator, Mapping
from typing import TYPE_CHECKING, Any

from swarmd.core.errors import unknown
from swarmd.core.keys import is_id
from swarmd.kit.conditions import Done, Not, Reported, Settled, is_drawn
from swarmd.mission.schema import (
    KINDS,
    NO_DRIVER,
    Element,
    Fallback,
    Map,
    Parallel,
    Reference,
    RunPart,
    Sequence,
    Switch,
    parts_in,
    report_of,
    split,
    tag_of,
)
from swarmd.settings.layered import Fault, Keys, fault_at

if TYPE_CHECKING:
    from swarmd.mission.document import Document

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


def is_part_name(name: str) -> bool:
    """True for a name that a part may have."""
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


def check_value(value: Any, keys: Keys, names: Collection[str]) -> Iterator[Fault]:
    """Yields the faults of one value of a mission, beyond its type: rules between its fields.

    `value`: an element (sequence, parallel, switch, fallback, part), a condition or a map. `keys`:
    its place in the file. `names`: the names of the mission's parts.
    """
    # 1. Rules of each kind of value.
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
            # A drawn condition is decided by a random draw at each step, so the chosen branch would
            # change from step to step.
            for index, branch in enumerate(value.children):
                if branch.when is not None and is_drawn(branch.when):
                    yield fault_at((*keys, "switch", index, "when"), _DRAWN)
        case Fallback():
            for index, item in enumerate(value.children[:-1]):
                if not _can_fail(item):
                    text = "never fails, and more items follow; give it a fails"
                    yield fault_at((*keys, "fallback", index), text)
        case Not() if is_drawn(value.condition):  # the result would change from step to step
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
    # 2. Fields that are only valid inside a certain parent: `when` in a switch, `transitions` in a
    #    sequence. A RunPart has no children.
    if isinstance(value, Sequence | Parallel | Fallback):
        for index, child in enumerate(value.children):
            if child.when is not None:
                text = "belongs to a branch of a switch; take until, or leave it out"
                yield fault_at((*keys, tag_of(value), index, "when"), text)
    if isinstance(value, Element) and not isinstance(value, RunPart | Sequence):
        for index, child in enumerate(value.children):
            if child.transitions is not None:
                yield fault_at((*keys, tag_of(value), index, "transitions"), _TRANSITIONS)


def check_names(element: Any, keys: Keys, names: Collection[str]) -> Iterator[Fault]:
    """Unknown names of parts and steps in the raw data of an element, also of invalid data."""
    if not isinstance(element, dict):
        return
    if element.get("part") and isinstance(element["part"], str):
        yield from _check_part(element["part"], (*keys, "part"), names)
    for kind in KINDS:
        children = element.get(kind)
        if not isinstance(children, list):
            continue
        if kind == "sequence":
            yield from _check_transitions(children, (*keys, kind))
        for index, child in enumerate(children):
            yield from check_names(child, (*keys, kind, index), names)


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
    # The last step of a repeated sequence may also be left by a transition to another step.
    can_be_left = last.transitions is not None and sequence.then == "repeat"
    if sequence.then != "stay" and not _can_end(last) and not can_be_left:
        text = f"never ends, and then is {sequence.then}; give it an until, or take stay"
        yield fault_at(place, text)


def _reached(sequence: Sequence) -> set[int]:
    """The indices of the steps that the sequence can reach; each transition is assumed to be met.

    A step without an end and without transitions is reported as a fault elsewhere. The step after
    such a step counts as reached, so that the mistake gives only one fault.
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
    (source, _) = split(mapping.source)
    (target, param) = split(mapping.target)
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


def valid_names(
    key: str, references: Mapping[str, str], names: Collection[str]
) -> tuple[dict[str, Reference], list[Fault]]:
    """The valid entries of `report` or `parameters`, and the faults of all other entries.

    `names`: the names of the mission's parts.
    """
    valid: dict[str, Reference] = {}
    faults: list[Fault] = []
    for own, reference in references.items():
        own_faults = list(_check_reference(reference, (key, own), names))
        if not _PARAMETER_NAME.fullmatch(own) or own in _RESERVED_NAMES:
            text = (
                "is not a valid name; expected letters, digits and _, but not recovery, avoidance"
                " or phase"
            )
            own_faults = [fault_at((key, own), text)]
        faults += own_faults
        if not own_faults:
            valid[own] = split(reference)
    return valid, faults


def check_whole(document: Document, data: Mapping[str, Any]) -> Iterator[Fault]:
    """Yields faults that concern several keys of the mission's file, or missing keys.

    `data`: the file as read from YAML.
    """
    if "mission" not in data:
        yield fault_at(("mission",), "is missing; expected a line that says what the mission does")
    if not data.get("parts"):
        yield fault_at(("parts",), "is missing; expected parts, such as move: {pattern: NAME}")
    if document.root is not None and document.root.when is not None:
        yield fault_at(("when",), "belongs to a branch of a switch; leave it out")
    if document.root is not None and document.root.transitions is not None:
        yield fault_at(("transitions",), _TRANSITIONS)
    yield from _check_parts(document)
    yield from _check_targets(document)


def _check_parts(document: Document) -> Iterator[Fault]:
    """Parts with a wrong name, without use, or with a parameter of the whole mission."""
    # If the root has faults, it is not known which parts are used.
    used_parts = set(document.names) if document.root is None else parts_in(document.root)
    for name in document.names:
        params = document.parts[name].params if name in document.parts else {}
        if not is_part_name(name):  # such as NO_DRIVER, which stands for no part in `drives`
            text = f"is not a valid name of a part; expected letters, digits and _, not {NO_DRIVER}"
            yield fault_at(("parts", name), text)
        elif name not in used_parts:
            yield fault_at(("parts", name), "is never stepped; name it in a step, or leave it out")
        elif "avoidance" in params:
            yield fault_at(("parts", name, "params", "avoidance"), _AVOIDANCE)


def _check_targets(document: Document) -> Iterator[Fault]:
    """Parameters of parts that two maps, two mission parameters, or one of each set."""
    mapped: set[Reference] = set()
    for keys, mapping in document.maps:
        target = split(mapping.target)
        if target in mapped:
            text = f"is {mapping.target}, which another map sets; keep one"
            yield fault_at((*keys, "to"), text)
        mapped.add(target)
    first_setter = dict.fromkeys(mapped, "a map")  # or the name of a mission parameter
    for parameter, target in document.parameters.items():
        _, part_parameter = target
        if part_parameter in _SHARED:
            yield fault_at(("parameters", parameter), _SHARED[part_parameter])
        if target in first_setter:
            text = f"is {'.'.join(target)}, which {first_setter[target]} sets too; keep one"
            yield fault_at(("parameters", parameter), text)
        first_setter.setdefault(target, parameter)
