"""The calibration keeps the contract of every pattern."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from msgspec import structs

from swarmd.core.values import Inputs, Odometry, Outputs, Pose, Twist
from swarmd.operator.calibration.floor import needed_floor, top_speeds
from swarmd.operator.calibration.pattern import Calibration, _distances
from swarmd.settings.platforms import load_platform
from swarmd.testing.pattern_contract import PatternContract, Subject
from swarmd.testing.scans import scan_of


class TestCalibration(PatternContract):
    pattern = Calibration


@pytest.mark.parametrize("sign", [1.0, -1.0])
@pytest.mark.parametrize("yaw", [0.0, 2.2, -0.5 * math.pi])
def test_ways_are_along_the_first_heading_to_its_left_and_turned(yaw: float, sign: float) -> None:
    ahead, left, turned = np.array([[0.0, 0.1, 0.3], [0.0, -0.2, 0.4], [0.0, 0.05, -0.1]])
    x = 5.0 + math.cos(yaw) * ahead - math.sin(yaw) * left
    y = -3.0 + math.sin(yaw) * ahead + math.cos(yaw) * left
    track = np.stack((np.arange(3.0), x, y, yaw + turned), axis=1)
    for axis, way in (("linear", ahead), ("lateral", left), ("angular", turned)):
        assert _distances(track, axis, sign) == pytest.approx(sign * way)


def driven(noise: float, until: float = 40.0) -> list[Outputs]:
    """The outputs at 50 Hz of a robot whose odometry stands still, with noise in m."""
    platform = load_platform("burger")
    pattern: Calibration = Subject(Calibration, platform, {}).make(1)  # type: ignore[assignment]
    rng, outputs = np.random.default_rng(1), list[Outputs]()
    while len(outputs) < 50 * until and not (outputs and outputs[-1].done):
        k = len(outputs)
        x, y = rng.normal(0.0, noise, 2).tolist()
        outputs.append(
            pattern.step(
                Inputs(
                    now=0.02 * k,
                    dt=0.02,
                    scan=scan_of(platform, room=2.8, seq=k // 10),
                    is_new_scan=k % 10 == 0,
                    odometry=Odometry(0.02 * k, Pose(x, y, 0.0), Twist()),
                )
            )
        )
    return outputs


@pytest.mark.parametrize("noise", [0.0, 2e-5])
def test_odometry_that_stands_still_ends_the_first_drive(noise: float) -> None:
    outputs = driven(noise)
    commanded = [out.twist.linear for out in outputs if out.twist is not None]
    assert "odometry shows no way when 0.22 m/s" in str(outputs[-1].done)
    assert outputs[-1].twist == Twist()
    assert 0.1 < 0.02 * sum(commanded) < 0.22 * 0.8
    assert min(commanded) == 0.0  # it does not drive back blindly


@pytest.mark.parametrize("speed", [0.2, 0.5, 1.0, 2.0])
@pytest.mark.parametrize("brake", [0.3, 1.0])
def test_the_floor_has_room_for_the_longest_drive_and_its_stop(speed: float, brake: float) -> None:
    base = load_platform("jackal")
    barrier = {**base.protection["barrier"], "braking_linear": brake, "others_speed": 2.2}
    limits = structs.replace(base.limits, linear=speed)
    fast = replace(base, limits=limits, protection={**base.protection, "barrier": barrier})
    top, front = top_speeds(fast)["linear"], float(base.footprint[:, 0].max())
    assert top == speed
    stop = 0.1 * top + 0.5 * top * top / brake
    assert front + 0.9 * top + stop < 0.5 * needed_floor(fast)
