"""A trace as a table in long form: a row for each instant and robot."""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

import numpy as np

from swarmd.core.errors import SwarmError
from swarmd.core.values import Array

if TYPE_CHECKING:
    from swarmd.sim.trace import Trace

TWIST = ("linear", "angular", "lateral")
BOUND = ("bound_bearing", "bound_gap", "bound_speed")
_PER_ROBOT = ("state", "reason", "active", "recovering", "decided", "evaded", "gap", "scan_age")
_COMMON = ("t", "robot", "platform", "x", "y", "heading", "present", *TWIST)
COLUMNS = (*_COMMON, *(f"requested_{name}" for name in TWIST), *_PER_ROBOT, *BOUND)
"""The columns of a table besides `report:KEY` and `reading:KEY`, in their order."""


def columns_of(trace: Trace) -> dict[str, Any]:
    """The columns by name, each of T * n values, in the order of the instants.

    Arrays that the trace lacks have no column. `heading` is within [-pi, pi].
    """
    from swarmd.sim.metrics.window import presence

    instants, n = trace.pose.shape[:2]
    heading = np.arctan2(np.sin(trace.pose[..., 2]), np.cos(trace.pose[..., 2]))
    found: dict[str, Any] = {
        "t": np.repeat(trace.t, n),
        "robot": np.tile(np.array(trace.ids, dtype=object), instants),
        "platform": np.tile(np.array(trace.platforms, dtype=object), instants),
        "x": trace.pose[..., 0],
        "y": trace.pose[..., 1],
        "heading": heading,
        "present": presence(trace),
    }
    found |= _parted(trace.safe, TWIST)
    found |= _parted(trace.requested, [f"requested_{name}" for name in TWIST])
    found |= {name: getattr(trace, name) for name in _PER_ROBOT}
    found |= _parted(trace.bound, BOUND)
    found |= {f"report:{name}": values for name, values in trace.report.items()}
    found |= {f"report:{name}": values for name, values in trace.words.items()}
    found |= {f"reading:{name}": values for name, values in trace.readings.items()}
    return {name: values.reshape(-1) for name, values in found.items() if values is not None}


def frame_of(trace: Trace) -> Any:
    """The trace as a pandas DataFrame; SwarmError if pandas is not installed."""
    return pandas().DataFrame(columns_of(trace))


def pandas() -> Any:
    """The module; SwarmError with the command that installs it."""
    try:
        return import_module("pandas")
    except ImportError as error:
        raise SwarmError("tables need pandas: pip install 'swarmd[table]'") from error


def _parted(values: Array | None, names: Any) -> dict[str, Array]:
    """The parts of values (T, n, k) by name."""
    return {} if values is None else {name: values[..., k] for k, name in enumerate(names)}
