"""Traces made by hand, and random ones that hold everything a trace can."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from swarmd.core.values import Array
from swarmd.settings.platforms import load_platform
from swarmd.sim.trace import Trace
from tests.support.traces import trace_of

PLATFORMS = {name: load_platform(name) for name in ("burger", "jackal", "waffle_pi")}
KNOWN = {
    "footprints": {name: p.footprint for name, p in PLATFORMS.items()},
    "meta": {
        "thresholds": {name: p.protection["threshold"] for name, p in PLATFORMS.items()},
        "v_max": {name: p.limits.linear for name, p in PLATFORMS.items()},
        "radio": {"neighborhood": "range", "range": 1.5},
    },
}


def run(pose: Array, contacts: Sequence[tuple[float, ...]] = (), **parts: Any) -> Trace:
    """Jackals at poses (T, n, 3), as `trace_of`; its meta has what metrics need."""
    return trace_of(pose, contacts, "jackal", **{**KNOWN, **parts})


def line(*xs: float) -> Array:
    """Poses (1, n, 3) along x."""
    pose = np.zeros((1, len(xs), 3))
    pose[0, :, 0] = xs
    return pose


def full_run(seed: int, n: int = 6, instants: int = 12) -> Trace:
    """A random run of several platforms that holds everything."""
    rng = np.random.default_rng(seed)
    shape = (instants, n)
    pose = np.empty((*shape, 3))
    start = rng.uniform(-2.0, 2.0, (n, 2))
    pose[..., :2] = start + np.cumsum(rng.normal(0.0, 0.05, (*shape, 2)), axis=0)
    pose[..., 2] = rng.uniform(-3.0, 3.0, shape)
    contacts = [
        (float(rng.uniform(0.0, instants / 10)), *rng.permutation(n)[:2], *rng.normal(size=2))
        for _ in range(2 * n if n > 1 else 0)
    ]
    decided = rng.integers(0, 3, shape)
    return run(
        pose,
        sorted(contacts),
        platforms=tuple(sorted(PLATFORMS)[i % 3] for i in range(n)),
        safe=rng.normal(size=(*shape, 3)),
        requested=rng.normal(size=(*shape, 3)),
        state=rng.choice(["running", "stopped"], shape),
        reason=rng.choice(["", "stale_scan", "operator"], shape),
        active=rng.random(shape) < 0.3,
        decided=decided,
        evaded=rng.integers(0, decided + 1),
        gap=rng.uniform(0.0, 2.0, shape),
        scan_age=rng.uniform(0.0, 0.3, shape),
        bound=rng.normal(size=(*shape, 3)),
        recovering=rng.random(shape) < 0.2,
        present=rng.random(shape) < 0.9,
        report={"opinion": rng.integers(0, 2, shape).astype(np.float64)},
    )
