"""Where a pattern performs: loads it, steps it, changes its parameters; answers by values.

The pattern host runs one in a child process, the inline runner one in its own. This is the only
place that calls a plugin's code.
"""

from __future__ import annotations

import math
import traceback
from collections.abc import Callable, Iterable, Mapping
from dataclasses import replace
from typing import Any, TypeVar

import msgspec
import numpy as np

from swarmd.core.errors import SwarmError
from swarmd.core.host_messages import (
    HostEvent,
    Load,
    Loaded,
    LoadRefused,
    ParamsSet,
    PatternFailed,
    SetParams,
    Step,
    Stepped,
)
from swarmd.core.values import Inputs, Message, Outputs, Platform, Scalar, Twist
from swarmd.kit.condition_state import Ending, ending_of
from swarmd.kit.factory import Assembled, Find, assemble, full_layers
from swarmd.kit.params import Params, build, schema

T = TypeVar("T")


class PatternExecutor:
    """Holds at most one pattern. A refused load leaves the one before in place."""

    def __init__(self, find: Find) -> None:
        self._find = find
        self._load: Load | None = None
        self._assembled: Assembled | None = None
        self._ending: Ending | None = None

    def handle(self, command: Load | Step | SetParams) -> HostEvent | None:
        """Carry a command out; None if it is for another generation."""
        if isinstance(command, Load):
            return self._on_load(command)
        if self._load is None or command.generation != self._load.generation:
            return None
        if isinstance(command, Step):
            return self._on_step(command)
        return self._on_set(command)

    def _on_load(self, load: Load) -> HostEvent:
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
        if isinstance(assembled, str):
            return LoadRefused(load.generation, assembled)
        ending = _guard(lambda: ending_of(load.until, load.platform))
        if isinstance(ending, str):
            return LoadRefused(load.generation, ending)
        self._load, self._assembled, self._ending = load, assembled, ending
        pattern = assembled.pattern
        channels = frozenset(pattern.channels)
        rate = float(pattern.rate)
        return Loaded(load.generation, rate, channels, assembled.params, pattern.touches)

    def _on_step(self, step: Step) -> HostEvent:
        assert self._assembled is not None
        pattern = self._assembled.pattern
        inputs, dropped = _typed(step.inputs, pattern.channels)
        outputs = _guard(lambda: _plain(pattern.step(inputs)))
        if isinstance(outputs, str):
            return PatternFailed(step.generation, outputs)
        if self._ending is not None:
            outputs = self._ending.applied(inputs, outputs)
        scan_seq = -1 if inputs.scan is None else inputs.scan.seq
        return Stepped(step.generation, outputs, scan_seq, dropped)

    def _on_set(self, command: SetParams) -> HostEvent:
        assert self._assembled is not None
        assert self._load is not None
        pattern, load = self._assembled.pattern, self._load
        layers = (*load.layers, ("runtime", command.values))

        def change() -> Mapping[str, tuple[Scalar | None, str]]:
            whole = full_layers(type(pattern), load.platform, layers)
            params, sources = build(type(pattern).params_type, whole)
            pattern.update(params)
            return sources

        sources = _guard(change)
        if isinstance(sources, str):
            return ParamsSet(command.generation, command.request, sources)
        self._load = replace(load, layers=layers)
        self._assembled = Assembled(pattern, sources)
        note = _beyond_limits(type(pattern).params_type, command.values, sources, load.platform)
        return ParamsSet(command.generation, command.request, note, sources)


def _beyond_limits(
    params_type: type[Params],
    changed: Iterable[str],
    params: Mapping[str, tuple[Scalar | None, str]],
    platform: Platform,
) -> str:
    """A note on the changed speeds that the base cannot reach; empty without one."""
    limits = {"m/s": platform.limits.linear, "rad/s": platform.limits.angular}
    notes = []
    for spec in schema(params_type):
        value, limit = params[spec.name][0], limits.get(spec.unit, math.inf)
        if spec.name in changed and isinstance(value, int | float) and abs(value) > limit:
            notes.append(
                f"{spec.name} is {value:g} {spec.unit},"
                f" but {platform.name} is limited to {limit:g} {spec.unit}"
            )
    return "; ".join(notes)


def _guard(call: Callable[[], T]) -> T | str:
    """What the call gives, or one line for what it raised. Being out of memory is not caught."""
    try:
        return call()
    except MemoryError:
        raise
    except SwarmError as error:
        return str(error)
    except Exception as error:  # a plugin may raise anything
        return in_one_line(error)


def in_one_line(error: BaseException) -> str:
    """What was raised, and where: `ZeroDivisionError: division by zero (shy.py:12)`."""
    text = str(error)
    frame = traceback.extract_tb(error.__traceback__)[-1]
    file, line = frame.filename, frame.lineno
    if isinstance(error, SyntaxError) and error.filename:  # raised before there was a frame
        text, file, line = error.msg, error.filename, error.lineno
    text = " ".join(text.split())
    return f"{type(error).__name__}: {text[:200]} ({file.rsplit('/', 1)[-1]}:{line})"


def _typed(inputs: Inputs, channels: Mapping[str, type]) -> tuple[Inputs, int]:
    """The inputs with only the messages of their channel's type, and how many were left out."""
    if not inputs.messages:
        return inputs, 0
    kept: list[Message] = []
    for message in inputs.messages:
        kind = channels.get(message.channel)
        if kind is None:
            continue
        try:
            kept.append(
                msgspec.structs.replace(message, value=msgspec.convert(message.value, kind))
            )
        except msgspec.ValidationError:
            continue
    return msgspec.structs.replace(inputs, messages=tuple(kept)), len(inputs.messages) - len(kept)


def _plain(outputs: object) -> Outputs:
    """The outputs in Python's own types; TypeError if a pattern gave something else."""
    if not isinstance(outputs, Outputs):
        raise TypeError(f"step gave {type(outputs).__name__}; wanted is Outputs")
    twist = outputs.twist
    if twist is not None:
        if not isinstance(twist, Twist):
            raise TypeError(f"the wish is {type(twist).__name__}; wanted is Twist or None")
        twist = Twist(float(twist.linear), float(twist.angular), float(twist.lateral))
    return Outputs(
        twist=twist,
        messages={str(name): _item(value) for name, value in outputs.messages.items()},
        report={str(name): _item(value) for name, value in outputs.report.items()},
        done=None if outputs.done is None else str(outputs.done),
    )


def _item(value: Any) -> Any:
    return value.item() if isinstance(value, np.generic) else value
