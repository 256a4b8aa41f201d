from __future__ import annotations

import math

import pytest

from swarmd.core.values import Limits
from swarmd.protection.constraints import linear_limit


@pytest.mark.parametrize(
    ("degrees", "limit"), [(0.0, 0.5), (180.0, 0.5), (90.0, 0.2), (-90.0, 0.2), (45.0, 0.2828)]
)
def test_the_limit_of_a_direction_is_that_of_the_component_that_meets_its_own(
    degrees: float, limit: float
) -> None:
    along = (math.cos(math.radians(degrees)), math.sin(math.radians(degrees)))
    assert linear_limit(Limits(0.5, 2.0, 0.2), along) == pytest.approx(limit, abs=1e-4)
