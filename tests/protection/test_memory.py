"""What a sensor that is blind nearby remembers: Jackal's, which sees nothing within 0.8 m."""

from __future__ import annotations

import math

import numpy as np
import pytest

from swarmd.protection.footprint import Sight
from swarmd.protection.memory import LASTS, NearMemory
from swarmd.settings import load_platform
from swarmd.testing.scans import scan_from
from swarmd.values import Pose

JACKAL = load_platform("jackal")
SIGHT = Sight(JACKAL.scan)
HERE = Pose()
PERIOD = 0.1
SPEED = 0.6


def remembering() -> NearMemory:
    return NearMemory(JACKAL.scan, SPEED)


def look(
    memory: NearMemory,
    things: dict[int, float],
    moved: Pose = HERE,
    seconds: float = PERIOD,
    beyond: float = math.inf,
) -> NearMemory:
    """One more scan: ranges by bearing in whole degrees, `beyond` elsewhere; what it remembers."""
    ranges = np.full(360, beyond)
    for degrees, distance in things.items():
        ranges[degrees % 360] = distance
    memory.update(scan_from(JACKAL, ranges, JACKAL.scan.bearings), SIGHT, moved, seconds)
    return memory


def entered(beyond: float = math.inf) -> NearMemory:
    """One that has driven towards something 0.85 m ahead until it was 0.75 m away, unseen."""
    memory = look(remembering(), {0: 0.85}, beyond=beyond)
    return look(memory, {}, Pose(0.10), beyond=math.inf)


def test_what_it_drives_up_to_is_remembered_where_it_is() -> None:
    memory = entered()
    assert memory.points == pytest.approx(np.array([[0.75, 0.0]]), abs=1e-9)
    assert memory.ages == pytest.approx([PERIOD])
    look(memory, {}, Pose(0.05, 0.0, math.pi / 2))
    assert memory.points == pytest.approx(np.array([[0.0, -0.70]]), abs=1e-9)
    assert memory.ages == pytest.approx([2 * PERIOD])


def test_what_comes_in_by_its_own_motion_is_remembered_at_the_edge() -> None:
    memory = look(remembering(), {359: 0.83, 0: 0.83, 1: 0.83})
    look(memory, {})
    assert len(memory.points) == 3
    assert np.hypot(*memory.points.T) == pytest.approx(np.full(3, 0.8), abs=1e-3)


def test_what_comes_in_stays_remembered_while_the_robot_backs_away_from_it() -> None:
    memory = look(remembering(), {0: 0.83})
    for _ in range(20):
        look(memory, {}, Pose(-0.04))
    assert len(memory.points) == 1


def test_what_is_too_far_off_to_have_come_in_is_not_there() -> None:
    memory = look(remembering(), {0: 0.95})
    assert not len(look(memory, {}).points)


def test_what_has_moved_aside_and_is_seen_there_has_not_come_in() -> None:
    memory = look(remembering(), {0: 0.83})
    assert not len(look(memory, {4: 0.83}).points)


def test_what_can_be_seen_through_is_forgotten() -> None:
    memory = entered()
    assert len(look(memory, {0: 0.77}).points) == 1  # noise, or something of the same thing
    assert not len(look(memory, {0: 2.0}).points)


def test_that_nothing_is_seen_does_not_show_that_it_has_gone() -> None:
    memory = entered()
    for _ in range(50):
        look(memory, {}, beyond=math.inf)
    assert len(memory.points) == 1


def test_it_is_forgotten_in_time() -> None:
    memory = entered()
    look(memory, {}, seconds=LASTS - 1.0)
    assert len(memory.points) == 1
    look(memory, {}, seconds=2.0)
    assert not len(memory.points)


def test_what_the_robot_leaves_faster_than_it_could_follow_is_forgotten() -> None:
    memory = entered()
    assert not len(look(memory, {}, Pose(-0.2)).points)


def test_what_it_sees_again_outside_is_not_remembered_inside() -> None:
    memory = entered()
    assert not len(look(memory, {0: 0.81}, Pose(-0.06)).points)
