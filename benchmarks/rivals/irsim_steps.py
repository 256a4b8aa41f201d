"""Speed of the simulator IR-SIM: `PYTHON irsim_steps.py ROBOTS RAYS RANGE NEAR SECONDS`.

Prints the simulated robot-seconds and their CPU seconds. PYTHON is an interpreter with ir-sim,
which is no dependency of swarmd. Discs between four walls; lidars of 360 rays have noise.
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
import numpy as np

STEP = 0.1  # s
SPEED, TURN = 0.2, 1.0  # m/s, rad/s
AHEAD = 1.0  # rad to each side
NOISE = 0.01  # m, standard deviation


def world(robots: int, rays: int, range_max: float) -> dict[str, Any]:
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
        "sensors": [
            {
                "name": "lidar2d",
                "number": rays,
                "range_max": range_max,
                "angle_range": 2.0 * math.pi,
                "noise": rays == 360,
                "std": NOISE,
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


def measure(
    robots: int, rays: int, range_max: float, near: float, seconds: float
) -> tuple[float, float]:
    """Robot-seconds that were simulated, and their CPU seconds, at least `seconds`."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "world.yaml"
        path.write_text(json.dumps(world(robots, rays, range_max)))  # JSON is YAML, too
        env = irsim.make(str(path), headless=True, log_level="ERROR", seed=0)
    scan = env.robot_list[0].get_lidar_scan()
    is_ahead = np.abs(np.linspace(scan["angle_min"], scan["angle_max"], rays)) < AHEAD
    names = list(range(robots))

    def advance(least: float) -> tuple[int, float]:
        start = time.process_time()
        steps = 0
        while (taken := time.process_time() - start) < least:
            actions = []
            for robot in env.robot_list:
                ranges = np.asarray(robot.get_lidar_scan()["ranges"])
                is_near = ranges[is_ahead].min() < near
                actions.append([0.0, TURN] if is_near else [SPEED, 0.0])
            env.step(actions, action_id=names)
            steps += 1
        return steps, taken

    advance(seconds / 2.0)
    steps, taken = advance(seconds)
    return robots * steps * STEP, taken


if __name__ == "__main__":
    print(*measure(int(sys.argv[1]), int(sys.argv[2]), *map(float, sys.argv[3:6])))
