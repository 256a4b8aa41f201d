"""A LaserScan whose header contradicts itself is named with both figures."""

from __future__ import annotations

import math

import numpy as np
import pytest

from swarmd.drivers.ros import messages
from swarmd.drivers.ros.from_ros import angles_finding
from swarmd.drivers.ros.to_ros import header

STEP = 2.0 * math.pi / 360


@pytest.mark.parametrize(
    ("angle_max", "step", "is_well"),
    [
        (359 * STEP, STEP, True),
        (360 * STEP, STEP, True),  # it counts the rays
        (358 * STEP, STEP, True),
        (6.28, STEP, True),  # rounded
        (0.0, STEP, True),  # not given
        (-359 * STEP, STEP, False),
        (359 * STEP, -STEP, False),
        (-359 * STEP, -STEP, True),
        (math.pi, STEP, False),
        (math.nan, STEP, False),
    ],
)
def test_the_last_ray_is_at_angle_max(angle_max: float, step: float, is_well: bool) -> None:
    message = messages.LaserScan(
        header=header(1.0, "base_scan"),
        angle_min=0.0,
        angle_max=angle_max,
        angle_increment=step,
        time_increment=0.0,
        scan_time=0.2,
        range_min=0.1,
        range_max=3.5,
        ranges=np.ones(360, np.float32),
        intensities=np.empty(0, np.float32),
    )
    finding = angles_finding(message)
    assert (finding is None) == is_well
    if finding is not None:
        assert not finding.is_well
        assert f"{angle_max:.4g}" in finding.text
        assert f"{359 * step:.4g}" in finding.text
