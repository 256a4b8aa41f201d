"""When a body moved off before it was touched, on a trace made by hand."""

from __future__ import annotations

import numpy as np
import pytest

from studies.safety.judge import collisions
from studies.safety.moved_off import moved_off
from swarmd.sim.trace import ARENA
from tests.support.traces import trace_of

T = np.linspace(0.0, 10.0, 201)
FRONT, BACK = 0.038, 0.102


def test_the_begin_of_the_motion_and_the_gap_then() -> None:
    """Face to back at 15 cm until 5 s, then 30 cm/s: they meet after half a second."""
    pose = np.zeros((len(T), 2, 3))
    pose[:, 1, 0] = FRONT + BACK + 0.15 - 0.3 * np.clip(T - 5.0, 0.0, 0.5)
    touches = [(5.5, 0, 1, 0.05, 0.3), (8.0, 0, ARENA, 0.05, 0.0)]
    trace = trace_of(pose, touches, ids=("a", "plate"), t=T, safe=np.full((len(T), 2, 3), 0.1))
    at_plate, at_wall = collisions(trace, {"plate"})
    found = moved_off(trace, at_plate)
    assert found is not None
    assert found.before == pytest.approx(0.5)
    assert found.gap == pytest.approx(0.15)
    assert found.text == "moved off 0.50 s before, at 15.0 cm"
    assert moved_off(trace, at_wall) is None


def test_a_body_at_rest_has_not_moved_off() -> None:
    pose = np.zeros((len(T), 2, 3))
    pose[:, 1, 0] = FRONT + BACK
    touches = [(5.0, 0, 1, 0.05, 0.0)]
    trace = trace_of(pose, touches, ids=("a", "plate"), t=T, safe=np.full((len(T), 2, 3), 0.1))
    (one,) = collisions(trace, {"plate"})
    assert moved_off(trace, one) is None
