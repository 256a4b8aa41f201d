"""Which robot drove into the other, and which was only thrown: on traces made by hand."""

from __future__ import annotations

import numpy as np
import pytest

from studies.safety.driven import drives, faults
from swarmd.core.values import Array
from swarmd.sim.trace import Trace
from tests.support.traces import trace_of

TOUCH = 5.0
T = np.linspace(0.0, 10.0, 501)
FRONT, BACK, SIDE = 0.038, 0.102, 0.089


def commands(before: float, after: float, turn: float = 0.0) -> Array:
    """(T, 3) `before` m/s and `turn` rad/s up to 0.2 s before the touch, then `after` m/s."""
    late = (T >= TOUCH - 0.2)[:, None]
    return np.where(late, (after, 0.0, 0.0), (before, turn, 0.0))


def run(command: Array, speed: float, turned: Array | None = None, after: float = 0.1) -> Trace:
    """Robot a is rammed from ahead; `after` s later its surface closes at `speed` m/s."""
    pose, safe = np.zeros((len(T), 2, 3)), np.zeros((len(T), 2, 3))
    safe[:, 0] = command
    pose[:, 1, 0] = FRONT + BACK
    pose[:, 0, 2] = 0.0 if turned is None else turned
    touches = [(TOUCH, 0, 1, 0.0, 0.3), (TOUCH + after, 0, 1, speed, 0.1)]
    return trace_of(pose, touches, ids=("a", "ram"), t=T, safe=safe)


def own_speeds(trace: Trace) -> list[float]:
    return [fault.own_speed for fault in faults(trace, {"ram"})]


def test_a_stopped_robot_thrown_by_a_ram_is_not_at_fault() -> None:
    assert own_speeds(run(commands(0.1, 0.0), 0.3)) == []


def test_fault_is_at_most_the_commanded_speed() -> None:
    assert own_speeds(run(commands(0.0, 0.1), 0.3)) == pytest.approx([0.1])
    assert own_speeds(run(commands(0.0, 0.2), 0.05)) == pytest.approx([0.05])


def test_a_robot_thrown_against_an_obstacle_it_backs_from_is_not_at_fault() -> None:
    assert own_speeds(run(commands(-0.1, -0.1), 0.3)) == []


@pytest.mark.parametrize(("after", "expected"), [(0.02, [0.88 * SIDE]), (0.4, [])])
def test_a_turning_robot_is_at_fault_until_it_has_braked(
    after: float, expected: list[float]
) -> None:
    """The robot turns at 1 rad/s until the touch, and brakes at 3 rad/s2 or more.

    A corner at its front comes nearer to the obstacle ahead.
    """
    turned = np.minimum(T - TOUCH, 0.0)
    assert own_speeds(run(commands(0.0, 0.0, 1.0), 0.3, turned, after)) == pytest.approx(
        expected, abs=0.01
    )


def test_a_robot_without_contact_moves_by_its_own_drives() -> None:
    trace = run(commands(0.0, 0.0), 0.0, turned=0.5 * T)
    free = drives(trace, 0)[(T > 0.0) & (T < TOUCH - 0.01)]
    assert free[:, :, 1] == pytest.approx(0.5)
    assert free[:, :, [0, 2]] == pytest.approx(0.0)


def test_possible_speeds_are_between_the_motion_before_and_the_commands() -> None:
    trace = run(commands(0.2, -0.1), 0.3)
    trace.pose[:, 0, 0] = np.minimum(0.2 * (T - TOUCH), 0.0)
    at = int(np.searchsorted(T, TOUCH + 0.1))
    assert drives(trace, 0)[at] == pytest.approx(
        np.array([[-0.1, 0.0, 0.0], [0.1, 0.0, 0.0]]), abs=0.021
    )
