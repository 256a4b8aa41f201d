"""The calibration keeps the contract of every pattern."""

from __future__ import annotations

import math

import numpy as np
import pytest

from swarmd.calibration.pattern import Calibration, _way
from swarmd.testing.pattern_contract import PatternContract


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
        assert _way(track, axis, sign) == pytest.approx(sign * way)
