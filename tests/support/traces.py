"""Traces and states of worlds made by hand."""

from __future__ import annotations

from collections.abc import Sequence
from functools import cache
from typing import Any

import numpy as np

from swarmd.core.values import Array
from swarmd.settings.platforms import load_platform
from swarmd.sim.live.state import Triple, WorldState
from swarmd.sim.trace import Trace


@cache
def footprint(platform: str) -> Array:
    """The outline of a platform."""
    return load_platform(platform).footprint


def trace_of(
    pose: Array, contacts: Sequence[tuple[float, ...]] = (), platform: str = "burger", **parts: Any
) -> Trace:
    """Poses (T, n, 3), ten a second; contacts are time, robot, other, and perhaps both speeds.

    `parts` replace or add fields of the trace.
    """
    instants, n = pose.shape[:2]
    rows = np.array([(*row, 0.0, 0.0)[:5] for row in contacts]).reshape(-1, 5)
    plain: dict[str, Any] = {
        "ids": tuple(f"r{i}" for i in range(n)),
        "t": np.arange(instants, dtype=np.float64) / 10.0,
        "safe": np.zeros_like(pose),
        "platforms": (platform,) * n,
        "contact_t": rows[:, 0],
        "contact_pair": rows[:, 1:3].astype(np.int64),
        "contact_speed": rows[:, 3:],
        **parts,
    }
    names = {platform, *plain["platforms"]}
    return Trace(**{"pose": pose, "footprints": {n: footprint(n) for n in names}, **plain})


def world_state(
    poses: Sequence[Triple], twists: Sequence[Triple] = (), time: float = 0.0
) -> WorldState:
    """The state of a live world of 6 x 6 m at a time; robots stand if they have no twists."""
    return WorldState(
        time=time,
        real_time_factor=1.0,
        arena=(6.0, 6.0),
        ids=tuple(f"r{i}" for i in range(len(poses))),
        poses=tuple(poses),
        twists=tuple(twists) or ((0.0, 0.0, 0.0),) * len(poses),
        commanded=(True,) * len(poses),
        contacts=0,
        arena_contacts=0,
        is_recording=True,
        recorded=time,
        overruns=0,
        dropped=0,
    )
