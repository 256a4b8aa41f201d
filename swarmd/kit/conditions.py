"""Conditions as values: what can end a run, end an element of a mission, or choose a branch.

In a mission's file a condition is a mapping, such as `timeout: 30`. `swarmd.mission.document` finds
the class by the key: `timeout` is the `tag` of class `Timeout`. `parse_condition` reads the short
forms of the command line. `swarmd.kit.condition_state` evaluates conditions. This module imports no
numpy, so that swarmctl starts fast.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Annotated, TypeAlias

from msgspec import Meta, Struct, field

from swarmd.core.bounds import BoundedScalar
from swarmd.core.errors import ConfigError, unknown
from swarmd.core.numbers import exact_number, finite_number

MAX_SECONDS = 1e7
MAX_CONDITIONS = 16
MAX_CONDITION_LENGTH = 200

Seconds = Annotated[float, Meta(gt=0.0, le=MAX_SECONDS)]
Bound = Annotated[float, Meta(ge=-1e9, le=1e9)]


class Timeout(Struct, frozen=True, tag="timeout", forbid_unknown_fields=True):
    """So many seconds have passed."""

    seconds: Seconds = field(name="timeout")

    def __str__(self) -> str:
        return f"{self.seconds:g} s have passed"


class Done(Struct, frozen=True, tag="done", forbid_unknown_fields=True):
    """A part of a mission is done; without a part, the pattern itself."""

    part: str = field(name="done", default="")

    def __str__(self) -> str:
        return f"{self.part or 'the pattern'} is done"


class Settled(Struct, frozen=True, tag="settled", forbid_unknown_fields=True):
    """A reported value has not changed for so many seconds."""

    report: str = field(name="settled")
    seconds: Seconds = field(name="for")

    def __str__(self) -> str:
        return f"{self.report} settled for {self.seconds:g} s"


class Nearer(Struct, frozen=True, tag="nearer", forbid_unknown_fields=True):
    """The range sensor measures something nearer than so many metres."""

    distance: Annotated[float, Meta(gt=0.0, le=1000.0)] = field(name="nearer")

    def __str__(self) -> str:
        return f"something is nearer than {self.distance:g} m"


class Reported(Struct, frozen=True, tag="report", forbid_unknown_fields=True):
    """A reported value equals a value, or is above or below a number; exactly one of them."""

    name: str = field(name="report")
    value: BoundedScalar | None = field(name="is", default=None)
    above: Bound | None = None
    below: Bound | None = None

    def __post_init__(self) -> None:
        """Check that there is one comparison."""
        _check_one(self.value, self.above, self.below, names="is, above, below")

    def __str__(self) -> str:
        equal = None if self.value is None else f" {self.value}"
        return f"{self.name} is{equal or _bound_text(self.above, self.below)}"


class Reading(Struct, frozen=True, tag="reading", forbid_unknown_fields=True):
    """A sensor reading is above or below a number; exactly one of them."""

    name: str = field(name="reading")
    above: Bound | None = None
    below: Bound | None = None

    def __post_init__(self) -> None:
        """Check that there is one comparison."""
        _check_one(self.above, self.below, names="above, below")

    def __str__(self) -> str:
        return f"reading {self.name} is{_bound_text(self.above, self.below)}"


class Neighbors(Struct, frozen=True, tag="neighbors", forbid_unknown_fields=True):
    """There are at least `count` neighbours within `within` m; without `within`, in radio reach.

    With `slope` chance decides: with n neighbours the condition becomes true within a second with
    the probability 1 / (1 + exp(slope (count - n))). So a positive slope makes the condition likely
    with many neighbours (the "neighbour count" of AutoMoDe, the automatic design of Francesca et
    al. 2014), and a negative slope with few (the "inverted neighbour count").
    """

    count: Annotated[float, Meta(ge=0.0, le=1000.0)] = field(name="neighbors")
    within: Annotated[float, Meta(gt=0.0, le=1000.0)] | None = None
    slope: Annotated[float, Meta(ge=-100.0, le=100.0)] | None = None

    def __str__(self) -> str:
        near = "" if self.within is None else f" within {self.within:g} m"
        drawn = "" if self.slope is None else f", drawn with slope {self.slope:g}"
        return f"neighbours{near} are at least {self.count:g}{drawn}"


class Probability(Struct, frozen=True, tag="probability", forbid_unknown_fields=True):
    """Holds within a second with the probability `value`, drawn at random at each evaluation.

    Over dt seconds the probability is 1 - (1 - p)^dt, so the rate of steps does not matter.
    """

    value: Annotated[float, Meta(gt=0.0, le=1.0)] = field(name="probability")

    def __str__(self) -> str:
        return f"a draw with probability {self.value:g} a second"


class AnyOf(Struct, frozen=True, tag="any", forbid_unknown_fields=True):
    """At least one of the conditions holds."""

    conditions: Annotated[tuple[Condition, ...], Meta(min_length=1)] = field(name="any")

    def __str__(self) -> str:
        return " or ".join(map(str, self.conditions))


class AllOf(Struct, frozen=True, tag="all", forbid_unknown_fields=True):
    """All conditions hold at once."""

    conditions: Annotated[tuple[Condition, ...], Meta(min_length=1)] = field(name="all")

    def __str__(self) -> str:
        return " and ".join(map(str, self.conditions))


class Not(Struct, frozen=True, tag="not", forbid_unknown_fields=True):
    """The condition does not hold."""

    condition: Condition = field(name="not")

    def __str__(self) -> str:
        return f"not: {self.condition}"


Condition: TypeAlias = (
    Timeout
    | Done
    | Settled
    | Nearer
    | Reported
    | Reading
    | Neighbors
    | Probability
    | AnyOf
    | AllOf
    | Not
)

_FORMS = ("timeout:SECONDS", "done", "settled:REPORT:SECONDS", "nearer:METRES", "report:KEY=VALUE")


def parse_condition(text: str) -> Condition:
    """The condition of a command line, such as `settled:opinion:5`; else ConfigError."""
    kind, _, rest = text.partition(":")
    if kind == "done" and not rest:
        return Done()
    if kind in ("timeout", "nearer"):
        value = _number(text, rest)
        return Timeout(value) if kind == "timeout" else Nearer(value)
    if kind == "settled":
        name, _, seconds = rest.rpartition(":")
        if name:
            return Settled(name, _number(text, seconds))
    if kind == "report":
        name, sign, value_text = rest.partition("=")
        if name and sign:
            is_boolean = value_text in ("true", "false")
            return Reported(name, value_text == "true" if is_boolean else exact_number(value_text))
    kinds = [form.partition(":")[0] for form in _FORMS]
    fault = f"condition {text!r}" if kind in kinds else unknown("condition", kind, kinds)
    raise ConfigError(f"{fault}; expected one of {', '.join(_FORMS)}")


def parse_conditions(texts: object) -> Condition:
    """The condition of a network request: any of several texts; ConfigError if malformed."""
    if not isinstance(texts, list | tuple) or not 1 <= len(texts) <= MAX_CONDITIONS:
        wanted = f"expected a list of 1 to {MAX_CONDITIONS} conditions"
        raise ConfigError(f"until is {str(texts)[:60]!r}; {wanted}")
    if any(not isinstance(text, str) or len(text) > MAX_CONDITION_LENGTH for text in texts):
        wanted = f"expected text of up to {MAX_CONDITION_LENGTH} characters"
        raise ConfigError(f"until holds a malformed condition; {wanted}")
    conditions = tuple(parse_condition(text) for text in texts)
    return conditions[0] if len(conditions) == 1 else AnyOf(conditions)


def simple_conditions(condition: Condition) -> Iterator[Condition]:
    """The leaf conditions of a condition: those below any, all and not."""
    if isinstance(condition, AnyOf | AllOf):
        for inner in condition.conditions:
            yield from simple_conditions(inner)
    elif isinstance(condition, Not):
        yield from simple_conditions(condition.condition)
    else:
        yield condition


def needs_of(condition: Condition) -> frozenset[str]:
    """The inputs that a robot must sense to evaluate the condition."""
    needs = set()
    for simple in simple_conditions(condition):
        if isinstance(simple, Nearer):
            needs.add("scan")
        elif isinstance(simple, Reading):
            needs.add(f"reading:{simple.name}")
        elif isinstance(simple, Neighbors):
            needs.add("neighbors" if simple.within is None else "neighbors.distance")
    return frozenset(needs)


def is_drawn(condition: Condition) -> bool:
    """Whether a random draw decides on the condition, or on a part of it."""
    return any(
        isinstance(simple, Probability)
        or (isinstance(simple, Neighbors) and simple.slope is not None)
        for simple in simple_conditions(condition)
    )


def _check_one(*values: object, names: str) -> None:
    if sum(value is not None for value in values) != 1:
        raise ValueError(f"needs exactly one of {names}")


def _bound_text(above: float | None, below: float | None) -> str:
    return f" below {below:g}" if above is None else f" above {above:g}"


def _number(text: str, word: str) -> float:
    value = finite_number(word)
    if not 0.0 < value <= MAX_SECONDS:
        wanted = f"expected a number above 0 and up to {MAX_SECONDS:g}, such as 5"
        raise ConfigError(f"condition {text!r}: is {word!r}; {wanted}")
    return value
