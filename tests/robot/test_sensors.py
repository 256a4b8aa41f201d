"""How long a robot remembers whom and what it heard."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from swarmd.core.messages import Reason
from swarmd.core.values import Neighbor, Odometry, Pose, Twist
from swarmd.protection.settings import Mode
from swarmd.robot.sensors import (
    AGE_UPDATE_PERIOD,
    MAX_INBOX_BYTES,
    MESSAGE_OVERHEAD,
    NEIGHBOR_TIMEOUT,
    ODOMETRY_TIMEOUT,
    Sensors,
)
from swarmd.settings.platforms import load_platform
from swarmd.testing.scans import empty_scan
from tests.support.platforms import with_mode


@pytest.fixture
def senses() -> Sensors:
    return Sensors(load_platform("waffle_pi"))


def test_neighbors_age_in_steps_and_time_out(senses: Sensors) -> None:
    senses.on_neighbors((Neighbor("b", 0.25, distance=1.0),), 10.0)
    ages = [senses.neighbors(10.0 + past)[0].age for past in (0.0, 0.4, 0.6, 1.7, 2.9)]
    assert ages == [
        0.25,
        0.25,
        0.25 + AGE_UPDATE_PERIOD,
        0.25 + 3 * AGE_UPDATE_PERIOD,
        0.25 + 5 * AGE_UPDATE_PERIOD,
    ]
    assert senses.neighbors(11.0)[0].distance == 1.0
    last = 10.0 + NEIGHBOR_TIMEOUT
    assert senses.on_message("b", "w", 1, last)
    assert not senses.on_message("b", "w", 1, last + 0.01)
    assert senses.neighbors(last + 0.01) == ()


def test_messages_arrive_once_and_the_oldest_are_dropped(senses: Sensors) -> None:
    senses.on_neighbors((Neighbor("b", 0.0),), 0.0)
    word = b"x" * 800
    fit = MAX_INBOX_BYTES // (MESSAGE_OVERHEAD + 800 + 4)  # a version byte and 3 of MessagePack
    for number in range(fit + 3):
        assert senses.on_message("b", f"w{number}", word, 0.5)
    got = senses.inputs(0.75, 0.1).messages
    assert [message.channel for message in got] == [f"w{k}" for k in range(3, fit + 3)]
    assert {message.age for message in got} == {0.25}
    assert senses.overflowed == 3
    assert senses.inputs(0.75, 0.1).messages == ()


def test_odometry_with_an_old_stamp_becomes_stale(senses: Sensors) -> None:
    senses.on_driver(True, "up")
    platform = load_platform("waffle_pi")
    for tick in range(13):
        now = tick * 0.05
        senses.on_odometry(Odometry(1.0, Pose(), Twist()), now)
        senses.on_scan(empty_scan(platform, tick, now), now)
        late = now > ODOMETRY_TIMEOUT + 1e-9
        assert senses.hold(now) is (Reason.STALE_ODOMETRY if late else None)


@pytest.mark.parametrize("mode", ["barrier", "potential_field", "stop_zone"])
def test_zeros_beside_near_rays_count_as_near_unless_in_barrier(mode: Mode) -> None:
    platform = with_mode(load_platform("burger"), mode)
    senses, ranges = Sensors(platform), np.full(360, 2.0)
    ranges[100] = 0.15
    senses.on_scan(replace(empty_scan(platform, 0, 0.0), ranges=ranges), 0.0)
    ranges = ranges.copy()
    ranges[97:104] = 0.0
    senses.on_scan(replace(empty_scan(platform, 1, 0.2), ranges=ranges), 0.2)
    assert senses.scan is not None
    assert np.isneginf(senses.scan.ranges[97:104]).all() == (mode != "barrier")


@pytest.mark.parametrize(
    "odometry",
    [
        Odometry(1.0, Pose(), Twist(angular=math.inf)),
        Odometry(1.0, Pose(math.nan), Twist()),
        Odometry(1.0, Pose(yaw=-math.inf), Twist()),
    ],
)
def test_non_finite_odometry_is_ignored(senses: Sensors, odometry: Odometry) -> None:
    first = Odometry(0.0, Pose(), Twist())
    senses.on_odometry(first, 10.0)
    senses.on_odometry(odometry, 10.2)
    assert senses.odometry is first
    assert senses.context(10.2).odometry_age == pytest.approx(0.2)
