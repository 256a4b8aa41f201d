"""In what two traces of a run differ: the fields, and the first instant and robot."""

from __future__ import annotations

from dataclasses import fields, replace
from typing import Any

import msgspec
import numpy as np
from numpy.typing import NDArray

from swarmd.sim.behaviour import RULES
from swarmd.sim.trace import Trace

_NOTES = ("made", RULES)


def trace_differences(a: Trace, b: Trace) -> list[str]:
    """The names of the fields that differ between two traces in at least one bit.

    Where a trace was made, and which rules are noted beside it, is no part of what it holds: an
    older trace has no such note.
    """
    names = [field.name for field in fields(Trace)]
    one, other = (
        replace(trace, meta={k: v for k, v in trace.meta.items() if k not in _NOTES})
        for trace in (a, b)
    )
    return [name for name in names if _bits(getattr(one, name)) != _bits(getattr(other, name))]


def first_difference(a: Trace, b: Trace) -> str:
    """The first instant at which two traces differ, with the fields that differ then.

    Such as `first at 3.40 s: safe, gap of tb3-02`: the robot is the first one in the first field,
    and the fields are those of this robot.
    Empty if no field by instant and robot differs.
    """
    count = min(len(a.t), len(b.t))
    # By field: the bytes that differ (count, bytes of an instant).
    differing = {}
    of_b = _by_instant(b)
    for name, was in _by_instant(a).items():
        now = of_b.get(name)
        if now is not None and (now.dtype, now.shape[1:]) == (was.dtype, was.shape[1:]):
            differing[name] = _octets(was[:count]) != _octets(now[:count])
    instants = {
        name: int(rows.any(axis=1).argmax()) for name, rows in differing.items() if rows.any()
    }
    if not instants:
        return ""
    first = min(instants.values())
    names = [name for name, instant in instants.items() if instant == first]
    # By field: whether each robot differs at this instant.
    by_robot = {name: differing[name][first].reshape(len(a.ids), -1).any(axis=1) for name in names}
    robot = int(by_robot[names[0]].argmax())
    return (
        f"first at {a.t[first]:.2f} s: {', '.join(name for name in names if by_robot[name][robot])}"
        f" of {a.ids[robot]}"
    )


def _by_instant(trace: Trace) -> dict[str, NDArray[Any]]:
    """The (T, n, ...) arrays of a trace by name: what robots do, then where they are."""
    names = ("requested", "safe", "gap", "bound", "state", "reason", "active", "pose")
    arrays = {
        **{name: getattr(trace, name) for name in names},
        **{f"report:{name}": values for name, values in trace.report.items()},
        **{f"reading:{name}": values for name, values in trace.readings.items()},
    }
    return {name: values for name, values in arrays.items() if values is not None}


def _octets(values: NDArray[Any]) -> NDArray[np.uint8]:
    """The bytes of (T, ...) values as (T, bytes of an instant)."""
    return np.ascontiguousarray(values).view(np.uint8).reshape(len(values), -1)


def _bits(value: Any) -> bytes:
    """A field of a trace as bytes: equal for equal types, shapes and bits."""
    return msgspec.msgpack.encode(value, enc_hook=lambda a: (a.dtype.str, a.shape, a.tobytes()))
