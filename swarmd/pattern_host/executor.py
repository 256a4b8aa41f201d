"""Loads a pattern, steps it and changes its parameters: answers each command with one event.

The pattern host runs an executor in a child process; the inline runner runs an executor in the own
process. No other module calls the code of a plugin during a run.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping
from typing import Any, NamedTuple, TypeVar, cast

import msgspec
import numpy as np
from msgspec.structs import replace

from swarmd.core import host_messages
from swarmd.core.errors import ParameterError, PluginError, SwarmError, named
from swarmd.core.refusal import Refusal
from swarmd.core.values import (
    PLACES_BY_POSE,
    Inputs,
    Message,
    Outputs,
    Platform,
    Scalar,
    Scan,
    Twist,
    Value,
)
from swarmd.kit.condition_state import UntilConditions, until_conditions
from swarmd.kit.factory import Assembled, Find, assemble, full_layers
from swarmd.kit.mistakes import one_line
from swarmd.kit.params import Params, build, schema
from swarmd.robot.sensing.scan_layout import ScanLayouts

T = TypeVar("T")

# A value of one of these types is immutable: it needs no copy if it has the channel's type.
_IMMUTABLE = frozenset({bool, int, float, str, bytes})


class PatternExecutor:
    """Holds at most one pattern. After a refused load the pattern before stays loaded."""

    def __init__(self, find: Find) -> None:
        self._find = find
        self._load: host_messages.Load | None = None
        self._assembled: Assembled | None = None
        self._until: UntilConditions | None = None
        self._scan: Scan | None = None  # of the last step
        self._layouts = ScanLayouts()  # what features of scans derive from the scans of this robot

    @property
    def needs(self) -> frozenset[str]:
        """The `needs` of the pattern and its parts; empty without a pattern."""
        return frozenset() if self._assembled is None else self._assembled.pattern.needs

    def handle(self, command: host_messages.SentCommand) -> host_messages.SentEvent | None:
        """Carry a command out and return its event; None for a command of another generation."""
        is_current = self._load is not None and command.generation == self._load.generation
        if isinstance(command, host_messages.Step):
            return self._on_step(command) if is_current else None
        if isinstance(command, host_messages.Load):
            return self._on_load(command)
        return self._on_set(command) if is_current else None

    def _on_load(self, load: host_messages.Load) -> host_messages.SentEvent:
        """Make the pattern and its end conditions; the pattern before stays after a refusal."""
        # `_guard` returns a `_Fault` if the code of the pattern raises.
        assembled = _guard(
            lambda: assemble(
                load.pattern,
                load.layers,
                find=self._find,
                robot=load.robot,
                platform=load.platform,
                rng=np.random.default_rng([load.seed, *load.robot.encode()]),
            )
        )
        if isinstance(assembled, _Fault):
            fault = assembled
            return host_messages.LoadRefused(
                load.generation, fault.text, fault.refusal, fault.parameter
            )
        until = _guard(lambda: until_conditions(load.until, load.platform))
        if isinstance(until, _Fault):
            return host_messages.LoadRefused(load.generation, until.text, _condition_refusal(until))
        # From here on the load succeeds: the new pattern takes the place of the pattern before.
        self._load = load
        self._assembled = assembled
        self._until = until
        pattern = assembled.pattern
        requested = dict(load.layers).get(host_messages.REQUEST_LAYER, {})
        params_type = type(pattern).params_type
        ended_by = frozenset[str]() if until is None else until.needs
        note = _beyond_limits(params_type, requested, assembled.params, load.platform)
        return host_messages.Loaded(
            load.generation,
            float(pattern.rate),
            frozenset(pattern.channels),
            assembled.params,
            pattern.touches,
            note=note,
            scan_delay=float(pattern.scan_delay),
            needs_places=pattern.uses_places
            or not PLACES_BY_POSE.isdisjoint(pattern.needs | ended_by),
        )

    def _on_step(self, step: host_messages.Step) -> host_messages.SentEvent:
        assert self._assembled is not None
        pattern = self._assembled.pattern
        inputs, dropped = _typed(step.inputs, pattern.channels)
        scan = inputs.scan
        last = self._scan
        # Each frame contains its own copy of the scan; `is_new_scan` must be set once per scan.
        if scan is not last and scan and last and scan.seq == last.seq and not inputs.is_new_scan:
            inputs = replace(inputs, scan=last)
        self._scan = inputs.scan
        self._layouts.serve(inputs.scan)
        self._layouts.serve(inputs.ranges)
        try:
            outputs = checked_outputs(pattern.step(inputs), pattern.channels)
        except MemoryError:
            raise
        except Exception as error:  # a plugin may raise anything
            return host_messages.PatternFailed(step.generation, _fault_of(error).text)
        if self._until is not None:
            outputs = self._until.apply(inputs, outputs)
        scan_seq = -1 if scan is None else scan.seq
        return host_messages.Stepped(step.generation, outputs, scan_seq, dropped)

    def _on_set(self, command: host_messages.SetParams) -> host_messages.SentEvent:
        assert self._assembled is not None
        assert self._load is not None
        pattern = self._assembled.pattern
        load = self._load
        layers = (*load.layers, (host_messages.REQUEST_LAYER, command.values))

        def change() -> host_messages.ParamSources:
            whole = full_layers(type(pattern), load.platform, layers)
            params, sources = build(type(pattern).params_type, whole)
            pattern.update(params)
            return sources

        sources = _guard(change)
        if isinstance(sources, _Fault):
            return host_messages.ParamsSet(command.generation, command.request, sources.text)
        self._load = replace(load, layers=layers)
        self._assembled = Assembled(pattern, sources)
        note = _beyond_limits(type(pattern).params_type, command.values, sources, load.platform)
        return host_messages.ParamsSet(command.generation, command.request, note, sources)


def checked_outputs(outputs: object, channels: Mapping[str, type]) -> Outputs:
    """The outputs of a pattern's step, with all values converted to Python's own types.

    `channels`: the declared message channels, with the type of each. PluginError if `outputs` is no
    Outputs, the command is no Twist, or a value on a declared channel cannot be converted to its
    type. Report values that are no scalars are left out.
    """
    if not isinstance(outputs, Outputs):
        raise PluginError(f"step gave {named(outputs)}; expected Outputs")
    twist = None if outputs.twist is None else _checked_twist(outputs.twist)
    messages = {
        str(channel): _checked_message(channel, value, channels.get(channel))
        for channel, value in outputs.messages.items()
    }
    report: dict[str, Scalar] = {}
    for name, reported in outputs.report.items():
        if type(reported) not in _IMMUTABLE:
            reported = _plain(reported)
        if isinstance(reported, (int, float, str)):
            report[str(name)] = reported
    done = None if outputs.done is None else str(outputs.done)
    grip = None if outputs.grip is None else bool(outputs.grip)
    return Outputs(twist, messages, report, done, grip)


def _checked_twist(twist: object) -> Twist:
    """The command with Python's own floats; PluginError if it is no Twist."""
    if not isinstance(twist, Twist):
        raise PluginError(f"the command is {named(twist)}; expected a Twist or None")
    linear = twist.linear
    angular = twist.angular
    lateral = twist.lateral
    are_floats = type(linear) is float and type(angular) is float and type(lateral) is float
    return twist if are_floats else Twist(float(linear), float(angular), float(lateral))


def _checked_message(channel: object, raw_value: object, declared_type: type | None) -> Value:
    """The value of a message, converted to the type of its channel; PluginError if impossible.

    `declared_type`: None for an undeclared channel, whose messages the daemon counts and drops.
    """
    value: Value = _plain(raw_value)
    if declared_type is None:
        return value
    try:
        return cast("Value", msgspec.convert(value, declared_type))
    except msgspec.ValidationError:
        expected = f"expected {declared_type.__name__}, as channels declares"
        raise PluginError(f"channel {channel!r} got {named(value)}; {expected}") from None


def _beyond_limits(
    params_type: type[Params],
    changed: Iterable[str],
    params: host_messages.ParamSources,
    platform: Platform,
) -> str:
    """A note on the changed speed parameters that exceed the base's limits; empty without."""
    limits = {"m/s": platform.limits.linear, "rad/s": platform.limits.angular}
    sideways = {"lateral": platform.limits.lateral}  # as the field of a Twist
    notes = []
    for spec in schema(params_type):
        limit = sideways.get(spec.name, limits.get(spec.unit, math.inf))
        value = params[spec.name][0]
        if spec.name in changed and isinstance(value, int | float) and abs(value) > limit:
            notes.append(
                f"{spec.name} is {value:g} {spec.unit},"
                f" but {platform.name} is limited to {limit:g} {spec.unit}"
            )
    return "; ".join(notes)


class _Fault(NamedTuple):
    """An error that a call raised, in one line."""

    text: str
    refusal: Refusal = Refusal.PATTERN_FAILED
    parameter: str = ""


def _condition_refusal(fault: _Fault) -> Refusal:
    """The refusal for a fault of an end condition.

    A missing sensor has a refusal of its own. All other faults have the refusal of a pattern that
    raises, but here the pattern is right, and the condition is invalid.
    """
    is_general = fault.refusal is Refusal.PATTERN_FAILED
    return Refusal.INVALID_CONDITION if is_general else fault.refusal


def _guard(call: Callable[[], T]) -> T | _Fault:
    """The result of the call, or the error that it raised. MemoryError is not caught."""
    try:
        return call()
    except MemoryError:
        raise
    except Exception as error:  # a plugin may raise anything
        return _fault_of(error)


def _fault_of(error: Exception) -> _Fault:
    if isinstance(error, ParameterError):
        return _Fault(str(error), host_messages.refusal_of(error), error.parameter)
    if isinstance(error, SwarmError):
        return _Fault(str(error), host_messages.refusal_of(error))
    return _Fault(one_line(error))


def _typed(inputs: Inputs, channels: Mapping[str, type]) -> tuple[Inputs, int]:
    """The inputs without messages that lack their channel's type, and the count left out."""
    if not inputs.messages:
        return inputs, 0
    kept: list[Message] = []
    for message in inputs.messages:
        kind = channels.get(message.channel)
        if kind is None:
            continue
        if type(message.value) is not kind or kind not in _IMMUTABLE:
            try:
                message = replace(message, value=msgspec.convert(message.value, kind))
            except msgspec.ValidationError:
                continue
        kept.append(message)
    return replace(inputs, messages=tuple(kept)), len(inputs.messages) - len(kept)


def _plain(value: Any) -> Any:
    return value.item() if isinstance(value, np.generic) else value
