"""Evaluates conditions from step to step, and ends a run when one of its conditions is met."""

from __future__ import annotations

import math
from collections.abc import Callable, Collection, Mapping, Sequence
from typing import TypeAlias

import msgspec
from msgspec import Struct
from numpy.random import Generator

from swarmd.core.errors import MissingSensorError
from swarmd.core.numbers import read_number
from swarmd.core.values import Inputs, Neighbor, Outputs, Platform, Scalar, Scan, lacks_text
from swarmd.kit import conditions

_ROUNDING = 1e-9


class Observation(Struct, frozen=True):
    """The values on which conditions are evaluated."""

    now: float
    reports: Mapping[str, Scalar]
    done: Collection[str] = ()  # the parts that are done, and "" if the whole pattern is
    scan: Scan | None = None
    readings: Mapping[str, float] = {}
    neighbors: tuple[Neighbor, ...] = ()
    rng: Generator | None = None  # of the robot, for conditions that draw; a command line has none


_Evaluate: TypeAlias = Callable[[Observation], bool]


class ConditionState:
    """Evaluates one condition from step to step; keeps its start and since when reports settled."""

    def __init__(self, condition: conditions.Condition) -> None:
        self.condition = condition
        self.start(0.0)

    def start(self, now: float) -> None:
        """Clear the memory; times count from now."""
        self._evaluate = _evaluator(self.condition, now)

    def is_met(self, observation: Observation) -> bool:
        """Whether the condition holds; call it at every step."""
        return self._evaluate(observation)


class UntilConditions:
    """Ends a run when one of its conditions is met; times count from its first step."""

    def __init__(self, condition: conditions.Condition) -> None:
        self.needs = conditions.needs_of(condition)
        """what the robot must sense, in the words of `Pattern.needs`"""
        several = condition.conditions if isinstance(condition, conditions.AnyOf) else (condition,)
        self._states = [ConditionState(part) for part in several]
        self._is_started = False

    def apply(self, inputs: Inputs, outputs: Outputs) -> Outputs:
        """The outputs of a step; `done` names the conditions that hold after the step.

        If the pattern itself is done, or no condition holds, the outputs are unchanged.
        """
        if not self._is_started:
            self._is_started = True
            for state in self._states:
                state.start(inputs.now)
        done = () if outputs.done is None else ("",)
        observation = Observation(inputs.now, outputs.report, done, inputs.scan, inputs.readings)
        # Every condition is evaluated at every step: a settled report is timed from step to step.
        met = [str(state.condition) for state in self._states if state.is_met(observation)]
        if not met or outputs.done is not None:
            return outputs
        return msgspec.structs.replace(outputs, done=f"until {' and '.join(met)}")


def until_conditions(until: Sequence[str], platform: Platform) -> UntilConditions | None:
    """The conditions that end a run; None for an empty `until`.

    ConfigError if a condition cannot be read, MissingSensorError if the platform lacks its inputs.
    """
    if not until:
        return None
    condition = conditions.parse_conditions(until)
    if lack := lacks_text(conditions.needs_of(condition), platform):
        raise MissingSensorError(f"the condition {lack}")
    return UntilConditions(condition)


def _evaluator(condition: conditions.Condition, started: float) -> _Evaluate:
    """The function that evaluates `condition` on the observation of a step; True if it holds.

    Some of these functions have a memory, so they must be called at every step. `started`: the
    start of the run in s, from which a timeout counts.
    """
    match condition:
        case conditions.AnyOf() | conditions.AllOf():
            parts = [_evaluator(part, started) for part in condition.conditions]
            combine = any if isinstance(condition, conditions.AnyOf) else all
            # A list, not a generator: every part is evaluated at every step, for its memory.
            return lambda seen: combine([evaluate(seen) for evaluate in parts])
        case conditions.Not():
            opposite = _evaluator(condition.condition, started)
            return lambda seen: not opposite(seen)
        case conditions.Timeout():
            # Steps are summed with rounding errors: the sum may be a little below the exact time.
            seconds = condition.seconds - _ROUNDING
            return lambda seen: seen.now - started >= seconds
        case conditions.Done():
            return lambda seen: condition.part in seen.done
        case conditions.Nearer():
            # A range of -inf (too close to measure) is nearer; a range of NaN (unknown) is not.
            distance = condition.distance
            return lambda seen: seen.scan is not None and bool((seen.scan.ranges < distance).any())
        case conditions.Settled():
            return _settled(condition)
        case conditions.Reported():
            return lambda seen: _is_as_wanted(condition, seen.reports.get(condition.name))
        case conditions.Reading():
            return lambda seen: _is_within(condition, seen.readings.get(condition.name))
        case conditions.Neighbors(slope=None):
            return lambda seen: _count(condition, seen) >= condition.count
        case conditions.Neighbors():  # with `slope`: true with a probability
            return _drawn(lambda seen: _probability(condition, seen), started)
        case conditions.Probability():
            return _drawn(lambda seen: condition.value, started)


def _settled(condition: conditions.Settled) -> _Evaluate:
    last: Scalar | None = None
    since = 0.0

    def evaluate(seen: Observation) -> bool:
        nonlocal last, since
        value = seen.reports.get(condition.report)
        if value is None or value != last:
            last = value
            since = seen.now
        return value is not None and seen.now - since >= condition.seconds - _ROUNDING

    return evaluate


def _drawn(probability: Callable[[Observation], float], started: float) -> _Evaluate:
    """A condition that is drawn at each evaluation: holds with 1 - (1 - p)^dt after dt seconds."""
    last = started

    def evaluate(seen: Observation) -> bool:
        nonlocal last
        assert seen.rng is not None
        seconds = seen.now - last
        last = seen.now
        return bool(seen.rng.random() >= (1.0 - probability(seen)) ** seconds)

    return evaluate


def _count(condition: conditions.Neighbors, seen: Observation) -> int:
    within = condition.within
    if within is None:
        return len(seen.neighbors)
    return sum(
        neighbor.distance is not None and neighbor.distance <= within for neighbor in seen.neighbors
    )


def _probability(condition: conditions.Neighbors, seen: Observation) -> float:
    """The probability within a second of a condition with a slope: 0.5 at its `count`."""
    assert condition.slope is not None
    x = condition.slope * (_count(condition, seen) - condition.count)
    return 0.5 * (1.0 + math.tanh(0.5 * x))  # the logistic function, without overflow


def _is_as_wanted(condition: conditions.Reported, value: Scalar | None) -> bool:
    wanted = condition.value
    if wanted is None:
        return _is_within(condition, value)
    if isinstance(value, str):
        return value == (wanted if isinstance(wanted, str) else str(wanted))
    return value == (read_number(wanted) if isinstance(wanted, str) else wanted)


def _is_within(condition: conditions.Reported | conditions.Reading, value: Scalar | None) -> bool:
    if value is None or isinstance(value, str):
        return False
    is_above = condition.above is None or value > condition.above
    return is_above and (condition.below is None or value < condition.below)
