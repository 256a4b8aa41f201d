"""The schema of a mission's file as structs (elements, parts, maps), and walks over elements.

An element is a RunPart, Sequence, Parallel, Switch or Fallback. The key that names the kind
(`part`, `sequence`, `parallel`, `switch`, `fallback`) is the tag of the struct.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Annotated, Literal, TypeAlias

import msgspec
from msgspec import Meta, Struct

from swarmd.core.bounds import BoundedScalar
from swarmd.kit.conditions import Condition, Reported, Settled
from swarmd.settings.layered import Keys

NO_DRIVER = "none"
"""The value of `drives` of a parallel in which no part drives."""

Number = Annotated[float, Meta(ge=-1e9, le=1e9)]
Elements: TypeAlias = "Annotated[tuple[Element, ...], Meta(min_length=1)]"
Reference: TypeAlias = tuple[str, str]
"""A part, and one of its reports or parameters."""


class ElementBase(Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """The keys of every element."""

    name: str = ""
    until: Condition | None = None  # ends the element
    fails: Condition | None = None  # makes the element fail
    retry: Annotated[int, Meta(ge=1, le=1000)] | None = None  # failures that restart the element
    when: Condition | None = None  # only in a branch of a switch
    # Only in a step of a sequence: by name of a step, the condition that leads to that step. The
    # first condition that holds counts, in the order of the file.
    transitions: Annotated[dict[str, Condition], Meta(min_length=1)] | None = None

    @property
    def label(self) -> str:
        """The name of the element in `drives` and `phase`."""
        return self.name


class RunPart(ElementBase, frozen=True, tag="part"):
    """Steps one part, whose command drives the robot."""

    part: Annotated[str, Meta(min_length=1, description="the name of a part")]

    @property
    def label(self) -> str:
        """The name of the element, by default the name of its part."""
        return self.name or self.part

    @property
    def children(self) -> tuple[Element, ...]:
        """Empty: a RunPart contains no element."""
        return ()


class Sequence(ElementBase, frozen=True, tag="sequence"):
    """Runs its steps in turn; after the last step it ends, stays there, or repeats (`then`)."""

    children: Elements = msgspec.field(name="sequence")
    then: Literal["end", "stay", "repeat"]


class Parallel(ElementBase, frozen=True, tag="parallel"):
    """Runs its items at once; the item with the label `drives` drives, or no item."""

    children: Elements = msgspec.field(name="parallel")
    drives: Annotated[str, Meta(description=f"the name of an item, or {NO_DRIVER}")]


class Switch(ElementBase, frozen=True, tag="switch"):
    """Runs the first branch whose `when` holds; the last branch may have no `when`."""

    children: Elements = msgspec.field(name="switch")


class Fallback(ElementBase, frozen=True, tag="fallback"):
    """Runs its first item; after the failure of an item, the next item."""

    children: Elements = msgspec.field(name="fallback")


Element: TypeAlias = RunPart | Sequence | Parallel | Switch | Fallback
KINDS = ("sequence", "parallel", "switch", "fallback")


class Part(Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """A pattern with its parameters; `private`: only robots of this mission hear its messages."""

    pattern: Annotated[str, Meta(min_length=1, description="the name of a pattern")]
    params: dict[str, BoundedScalar | None] = {}
    private: bool = False


class Map(Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Sets a parameter (`to`) by a report of another part (`from`).

    `values`: a list with the value for each reported number 0, 1, 2 ..., or a mapping with the
    value for each reported text. Without `values`, the value is `base` + `step` times the reported
    number. `count`: how many numbers may be reported; by default the number of opinions of a vote.
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
    """The keys of a mission's file beside the keys of its outermost element.

    `report`: the mission's own reports, each a PART.KEY. `parameters`: the mission's own
    parameters, each a PART.PARAMETER.
    """

    mission: str = ""
    parts: dict[str, Part] = {}
    map: list[Map] = []
    report: dict[str, str] = {}
    parameters: dict[str, str] = {}
    recovery: bool | None = None


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
        yield from elements(child, (*keys, tag_of(root), index))


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


def tag_of(element: Element) -> str:
    """The key that names the kind of an element."""
    return str(element.__struct_config__.tag)
