"""True ranges of lidars: the distance from each lidar to the nearest other robot or wall."""

from __future__ import annotations

import numpy as np

from swarmd.core.values import Array
from swarmd.settings.settings import load_platform
from swarmd.sim.trace import Trace
from swarmd.sim.world.arena import parse_arena
from swarmd.sim.world.geometry import apart, transform


def lidar_ranges(trace: Trace) -> Array:
    """(T, n) the true distance in m from each lidar to the nearest outline or outer wall.

    ConfigError if the trace names no arena.
    """
    arena = parse_arena(str(trace.meta["arena"]))
    half = np.array([arena.length, arena.width]) / 2.0
    offsets = {name: np.array([load_platform(name).scan.offset]) for name in trace.platforms}
    robots = range(len(trace.ids))
    lidars = [transform(offsets[trace.platforms[i]], trace.pose[:, i])[:, 0] for i in robots]
    outlines = [transform(trace.footprint(i), trace.pose[:, i]) for i in robots]
    nearest = np.stack([(half - np.abs(lidar)).min(axis=1) for lidar in lidars], axis=1)
    for i in robots:
        for j in robots:
            if i != j:
                ends = np.roll(outlines[j], -1, axis=1)
                away = apart(lidars[i][:, None], outlines[j], ends).min(axis=1)
                nearest[:, i] = np.minimum(nearest[:, i], away)
    return nearest
