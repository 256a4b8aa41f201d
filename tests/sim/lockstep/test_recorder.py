"""The values of robots in a lockstep trace."""

from __future__ import annotations

import math

import numpy as np
import pytest

from swarmd.sim.lockstep.lockstep import simulate_run
from swarmd.sim.scenarios.scenariofile import scenario_of
from swarmd.sim.trace import Trace


@pytest.fixture(scope="module")
def trace() -> Trace:
    """Two robots that drive straight on, one of them at a wall 1 m ahead of its axle."""
    scenario = scenario_of(
        {
            "duration": 8.0,
            "realism": "ideal",
            "arena": {"size": [12.0, 12.0]},
            "platforms": {"careful": {"extends": "burger", "protection": {"mode": "barrier"}}},
            "groups": {
                "all": {
                    "platform": "careful",
                    "pattern": "drive",
                    "count": 2,
                    "parameters": {"speed": 0.2, "recovery": True},
                    "start": {"layout": "list", "poses": [[5.0, 0.0, 0.0], [-2.0, 0.0, 0.0]]},
                }
            },
        }
    )
    return simulate_run(scenario, 0)


def test_keeps_the_tightest_constraint_and_nan_without_one(trace: Trace) -> None:
    assert trace.bound is not None
    assert trace.active is not None
    bound = trace.bound[:, 0]
    is_bound = ~np.isnan(bound).any(axis=1)
    assert is_bound.any()
    assert (trace.active[:, 0] | ~is_bound).all()
    first = int(np.argmax(is_bound))
    assert abs(bound[first, 0]) < math.radians(60.0)
    assert 0.0 < bound[first, 2] < 0.2
    assert np.isnan(trace.bound[:, 1]).all()
    assert trace.recovering is not None
    np.testing.assert_array_equal(trace.recovering.any(axis=0), [True, False])
    assert trace.meta["modes"] == {"careful": "barrier"}


def test_keeps_gap_and_scan_age(trace: Trace) -> None:
    assert trace.gap is not None
    assert trace.scan_age is not None
    to_wall = 6.0 - trace.pose[:, 0, 0] - 0.038
    is_seen = ~np.isnan(trace.gap[:, 0]) & (trace.t > 1.0) & (np.abs(trace.pose[:, 0, 2]) < 0.1)
    np.testing.assert_allclose(trace.gap[is_seen, 0], to_wall[is_seen], atol=0.06)
    assert np.isnan(trace.gap[:, 1]).all()
    assert np.isnan(trace.scan_age[0]).all()
    assert (trace.scan_age[5:] < 0.3).all()
