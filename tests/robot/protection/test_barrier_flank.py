"""Closed loop: a turning robot does not meet a thing that moves along its outline."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pytest

from swarmd.core.values import Pose, Twist
from swarmd.settings.platforms import load_platform
from tests.support.examples import part
from tests.support.filter_sim import FilterSim, Shape, pole, under_barrier
from tests.support.homing import HomingSim
from tests.support.kernel_forms import long_run

pytestmark = long_run

NO_FAULT = 0.02  # m/s: a slower contact is not a fault of the robot
STEP, BEGIN = 0.1, 0.8  # s
# A way at 0.3 m/s, a place each step, past the flank of a Burger that turns, in m.
WAY = np.array((
    (-0.293, 0.649), (-0.269, 0.650), (-0.239, 0.653), (-0.210, 0.656), (-0.180, 0.660),
    (-0.158, 0.644), (-0.139, 0.621), (-0.120, 0.598), (-0.101, 0.575), (-0.082, 0.551),
    (-0.064, 0.527), (-0.048, 0.502), (-0.032, 0.476), (-0.019, 0.449), (-0.004, 0.424),
    (0.015, 0.401), (0.036, 0.379), (0.058, 0.359), (0.081, 0.340), (0.106, 0.323),
    (0.131, 0.306), (0.157, 0.291), (0.183, 0.276),
))  # fmt: skip
REQUESTS = (Twist(0.22, 1.745), Twist(0.176, 2.84), Twist(-0.032, 2.121))


@dataclass(frozen=True, slots=True, eq=False)
class Passing(Shape):
    """A thing that moves along `WAY`."""

    def at(self, time: float) -> Pose:
        step, share = divmod(max(time - BEGIN, 0.0), STEP)
        i = min(int(step), len(WAY) - 2)
        x, y = (WAY[i] + share / STEP * (WAY[i + 1] - WAY[i])).tolist()
        return Pose(x, y)


@pytest.mark.parametrize("noise", part([0.01], [0.0]))
@pytest.mark.parametrize("phase", np.arange(0.0, 0.2, 0.02).round(2).tolist())
def test_pole_that_passes_a_turning_flank_is_not_met(phase: float, noise: float) -> None:
    """Told a speed of 0.31 m/s, so that no step of the pole is faster."""
    platform = under_barrier(load_platform("burger"), unseen_extent=0.0, others_speed=0.31)
    passing = Passing(pole(0.02).corners)
    sim = FilterSim(platform, [passing], phase=phase, noise=noise, seed=20007)
    touch = sim.run(lambda time: REQUESTS[min(int(time), 2)], 3.2).touch
    assert touch is None or touch.speed <= NO_FAULT


@pytest.mark.short_rows(1)
@pytest.mark.parametrize("first", part([0], [1]))
@pytest.mark.parametrize("seed", [58, 64, 100, 133])
def test_pole_that_homes_in_on_a_turning_waffle_pi_is_not_met(seed: int, first: int) -> None:
    """At exactly `others_speed`; its aim sweeps along the outline. 20 phases of each ride.

    In 64 it goes around a corner to the edge that swings outwards, in 133 the turn ends late within
    a step of the simulated stop, in 58 it comes beside a corner that slides past it.
    """
    phases = range(first, 20, 2)
    sims = [HomingSim("waffle_pi", seed, begin=0.8, phase=0.01 * phase) for phase in phases]
    faults = [sim.fault(4.0) or 0.0 for sim in sims]
    assert max(faults) <= NO_FAULT, faults


@pytest.mark.short_rows(1)
@pytest.mark.parametrize("side", [1.0, -1.0])
@pytest.mark.parametrize(
    ("name", "requested", "start", "velocity"),
    [
        ("waffle_pi", Twist(0.26), Pose(0.256, 1.061, -2.239), (0.084, -0.391)),
        ("rosbot_xl", Twist(0.8), Pose(0.359, 1.668, -0.154), (0.319, -0.734)),
        ("rosbot_xl", Twist(lateral=-0.8), Pose(1.951, -0.797, 1.226), (-0.786, -0.151)),
        *part([], [("waffle_pi", Twist(0.26), Pose(0.14, 1.133, 1.15), (0.171, -0.361))]),
    ],
)
def test_body_that_slides_to_a_corner_does_not_meet_a_robot_that_brakes(
    name: str, requested: Twist, start: Pose, velocity: tuple[float, float], side: float
) -> None:
    """It comes from the side, straight and at `others_speed`, while the robot drives."""
    platform = under_barrier(load_platform(name), unseen_extent=0.0)
    outline = (platform.footprint * (1.0, side))[:: int(side)]
    pose = Pose(start.x, side * start.y, side * start.yaw)
    body = Shape(outline, pose, (velocity[0], side * velocity[1]))
    wanted = Twist(requested.linear, 0.0, side * requested.lateral)
    sweep = platform.scan.sweep
    is_rolling = sweep is not None and sweep.duration > 0.0
    for phase in np.arange(0.0, 1.0 / platform.scan.rate, 0.02).tolist():
        sim = FilterSim(platform, [body], phase=phase, noise=0.01, rolling=is_rolling)
        touch = sim.run(wanted, 2.5).touch
        assert touch is None or touch.speed <= NO_FAULT, phase
