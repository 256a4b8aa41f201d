"""Line formation: the contract with both kinds of sensing, and its place."""

from __future__ import annotations

import numpy as np

from swarmd.patterns.line_formation.pattern import LineFormation
from swarmd.settings.settings import load_platform
from swarmd.testing.pattern_contract import PatternContract, Subject


class TestLineFormation(PatternContract):
    pattern = LineFormation


class _ByBearing(LineFormation):
    """The same where range and bearing are provided; mirrored scans do not mirror neighbours."""

    needs = LineFormation.needs | {"neighbors", "neighbors.distance", "neighbors.bearing"}
    is_symmetric = False


class TestLineFormationByBearing(PatternContract):
    pattern = _ByBearing
    platforms = ("burger", "jackal")


def test_its_place_is_one_spacing_from_the_others() -> None:
    pattern = Subject(LineFormation, load_platform("burger"), {"spacing": 1.5}).make()
    assert isinstance(pattern, LineFormation)
    place = pattern.place(np.array([(1.0, 0.0), (2.0, 0.0)]))
    np.testing.assert_allclose(place, np.array((-0.5, 0.0)), atol=1e-9)
