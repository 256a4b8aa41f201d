"""Whether conditions are met, from step to step.

What ends a run of any pattern beside the pattern itself.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping, Sequence
from typing import TypeAlias

import msgspec
from msgspec import Struct

from swarmd.core.errors import ConfigError
from swarmd.core.values import Inputs, Outputs, Platform, Scan
from swarmd.kit.conditions import (
    AllOf,
    AnyOf,
    Compared,
    Condition,
    Done,
    Nearer,
    Not,
    Scalar,
    Settled,
    Timeout,
    needs_of,
    parse_conditions,
)

_ROUNDING = 1e-9


class Facts(Struct, frozen=True):
    """What conditions are about. `done`: the parts that are, "" for the whole pattern."""

    now: float
    reports: Mapping[str, Scalar]
    done: Collection[str] = ()
    scan: Scan | None = None
    readings: Mapping[str, float] = {}


_Check: TypeAlias = Callable[[Facts], bool]


class Watch:
    """One condition, watched from `begin` on; it remembers what it must."""

    def __init__(self, condition: Condition) -> None:
        self.condition = condition
        self.begin(0.0)

    def begin(self, now: float) -> None:
        """Forget all; time counts from now."""
        self._check = _checked(self.condition, now)

    def is_met(self, facts: Facts) -> bool:
        """Whether the condition holds; to be asked at every step."""
        return self._check(facts)


def _checked(condition: Condition, began: float) -> _Check:
    if isinstance(condition, AnyOf | AllOf):
        checks = [_checked(inner, began) for inner in condition.conditions]
        is_any = isinstance(condition, AnyOf)
        # All are asked each time: what they remember must not depend on the others.
        return lambda facts: (any if is_any else all)([check(facts) for check in checks])
    if isinstance(condition, Not):
        inner = _checked(condition.condition, began)
        return lambda facts: not inner(facts)
    if isinstance(condition, Timeout):
        end = condition.seconds - _ROUNDING
        return lambda facts: facts.now - began >= end
    if isinstance(condition, Done):
        part = condition.part
        return lambda facts: part in facts.done
    if isinstance(condition, Nearer):
        distance = condition.distance
        # Too close to measure is -inf, which is nearer; what is unknown is not.
        return lambda facts: facts.scan is not None and bool((facts.scan.ranges < distance).any())
    if isinstance(condition, Settled):
        return _Steady(condition).check
    return _comparison(condition)


class _Steady:
    """Since when a reported value has been what it is."""

    def __init__(self, condition: Settled) -> None:
        self._key, self._seconds = condition.report, condition.seconds - _ROUNDING
        self._value: Scalar | None = None
        self._since = 0.0

    def check(self, facts: Facts) -> bool:
        value = facts.reports.get(self._key)
        if value is None or value != self._value:
            self._value, self._since = value, facts.now
        return value is not None and facts.now - self._since >= self._seconds


def _comparison(condition: Compared) -> _Check:
    name, relation, wanted = condition.name, condition.relation, condition.value

    def check(facts: Facts) -> bool:
        source: Mapping[str, Scalar] = facts.readings if condition.is_reading else facts.reports
        value = source.get(name)
        if value is None:
            return False
        if relation == "is":
            return value == wanted and isinstance(value, str) == isinstance(wanted, str)
        if isinstance(value, str) or isinstance(wanted, str):
            return False
        return value > wanted if relation == "above" else value < wanted

    return check


class Ending:
    """Watches the steps of a run; its time counts from the first step."""

    def __init__(self, condition: Condition) -> None:
        several = condition.conditions if isinstance(condition, AnyOf) else (condition,)
        self._watches = [Watch(one) for one in several]
        self._has_begun = False

    def applied(self, inputs: Inputs, outputs: Outputs) -> Outputs:
        """The outputs of a step; if conditions hold after it, done with those that hold."""
        if not self._has_begun:
            self._has_begun = True
            for watch in self._watches:
                watch.begin(inputs.now)
        done = () if outputs.done is None else ("",)
        facts = Facts(inputs.now, outputs.report, done, inputs.scan, inputs.readings)
        # Every watch is asked at every step: a settled report is timed from step to step.
        met = [str(watch.condition) for watch in self._watches if watch.is_met(facts)]
        if not met or outputs.done is not None:
            return outputs
        return msgspec.structs.replace(outputs, done=f"until {' and '.join(met)}")


def ending_of(until: Sequence[str], platform: Platform) -> Ending | None:
    """What any of these conditions ends; None without one.

    ConfigError if one is none, or needs what the platform does not provide.
    """
    if not until:
        return None
    condition = parse_conditions(until)
    missing = sorted(needs_of(condition) - platform.provides)
    if missing:
        raise ConfigError(
            f"the condition needs {', '.join(missing)}, which {platform.name} does not provide"
        )
    return Ending(condition)
