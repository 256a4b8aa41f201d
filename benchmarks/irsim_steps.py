"""Speed of the simulator IR-SIM: `PYTHON benchmarks/irsim_steps.py ROBOTS:RAYS [ROBOTS:RAYS ...]`.

The speed is in robot-seconds per second of processor time. PYTHON is an interpreter with ir-sim,
which is no dependency of swarmd; `python -m benchmarks.peers` runs this file. Each
robot drives to random goals, one after the other, in an arena of 1 m2 a robot between four walls.
Each step of 0.1 s casts the rays of each robot. Prints a JSON list of rows: robots, rays, and the
speed of each sample.
"""

from __future__ import annotations

import json
import math
import sys
import tempfile
import time
from itertools import pairwise
from pathlib import Path
from typing import Any

import irsim

STEP = 0.1  # s
RANGES = {24: 1.2, 360: 3.5}
"""The range of the lidar in m by its number of rays, as in benchmarks/peers.py."""
SAMPLES, SECONDS = 5, 2.0  # samples of a row, processor seconds of a sample


def world(robots: int, rays: int) -> dict[str, Any]:
    """The world file of IR-SIM, as a mapping."""
    side = math.sqrt(robots) + 0.1
    corners = [[0.0, 0.0], [side, 0.0], [side, side], [0.0, side], [0.0, 0.0]]
    robot = {
        "number": robots,
        "distribution": {
            "name": "random",
            "range_low": [0.2, 0.2, -math.pi],
            "range_high": [side - 0.2, side - 0.2, math.pi],
        },
        "kinematics": {"name": "diff"},
        "shape": {"name": "circle", "radius": 0.15},
        "vel_min": [-0.26, -1.8],
        "vel_max": [0.26, 1.8],
        "behavior": {
            "name": "dash",
            "wander": True,
            "range_low": [0.2, 0.2, -math.pi],
            "range_high": [side - 0.2, side - 0.2, math.pi],
        },
        "sensors": [
            {
                "name": "lidar2d",
                "number": rays,
                "range_max": RANGES[rays],
                "angle_range": 2.0 * math.pi,
            }
        ],
    }
    walls = [
        {"shape": {"name": "linestring", "vertices": [begin, end]}, "unobstructed": False}
        for begin, end in pairwise(corners)
    ]
    return {
        "world": {
            "height": side,
            "width": side,
            "step_time": STEP,
            "collision_mode": "unobstructed",
        },
        "robot": [robot],
        "obstacle": walls,
    }


def rates(robots: int, rays: int) -> list[float]:
    """Robot-seconds a processor second by sample; a first sample, for warming up, is discarded."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "world.yaml"
        path.write_text(json.dumps(world(robots, rays)))  # JSON is YAML, too
        env = irsim.make(str(path), headless=True, log_level="ERROR", seed=0)
    rates_of_samples = []
    for _ in range(SAMPLES + 1):
        start, steps = time.process_time(), 0
        while time.process_time() - start < SECONDS:
            env.step()
            steps += 1
        rates_of_samples.append(robots * STEP * steps / (time.process_time() - start))
    return rates_of_samples[1:]


if __name__ == "__main__":
    rows = [tuple(map(int, word.split(":"))) for word in sys.argv[1:]]
    print(json.dumps([{"robots": n, "rays": k, "rates": rates(n, k)} for n, k in rows]))
