from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from swarmd.core.values import Array
from swarmd.protection.constraints import passive_caps, reciprocal_caps

ROOM = st.floats(-0.5, 5.0)
BRAKING = st.floats(0.02, 5.0)
SPEED = st.floats(0.0, 1.5)
SECONDS = st.floats(0.0, 1.0)
MORE = st.floats(0.0, 2.0)


def one(value: float) -> Array:
    return np.array([value])


def passive(room: float, braking: float, others: float, unseen: float, tick: float) -> float:
    return float(passive_caps(one(room), one(braking), others, unseen, tick)[0])


def reciprocal(room: float, braking: float, unseen: float, tick: float) -> float:
    return float(reciprocal_caps(one(room), one(braking), unseen, tick)[0])


@given(ROOM, BRAKING, SPEED, SECONDS, SECONDS)
def test_at_the_cap_the_room_is_just_used_up(
    room: float, braking: float, others: float, unseen: float, tick: float
) -> None:
    cap = passive(room, braking, others, unseen, tick)
    own = cap * tick + cap**2 / (2.0 * braking)
    theirs = others * (unseen + tick + cap / braking)
    least = others * (unseen + tick)  # they come so far even if the robot stands
    assert own + theirs == pytest.approx(max(room, least), rel=1e-9, abs=1e-9)


@given(ROOM, BRAKING, SECONDS, SECONDS)
def test_two_that_share_never_use_more_than_half_each(
    room: float, braking: float, unseen: float, tick: float
) -> None:
    cap = reciprocal(room, braking, unseen, tick)
    own = cap * (2.0 * tick + unseen) + cap**2 / (2.0 * braking)
    assert own == pytest.approx(0.5 * max(room, 0.0), rel=1e-9, abs=1e-9)


@given(ROOM, BRAKING, SPEED, SECONDS, SECONDS, MORE)
def test_older_scans_faster_others_and_less_room_never_raise_a_cap(
    room: float, braking: float, others: float, unseen: float, tick: float, more: float
) -> None:
    cap = passive(room, braking, others, unseen, tick) + 1e-12
    assert passive(room, braking, others, unseen + more, tick) <= cap
    assert passive(room, braking, others + more, unseen, tick) <= cap
    assert passive(room - more, braking, others, unseen, tick) <= cap
    assert passive(room, braking, others, unseen, tick + more) <= cap
    half = reciprocal(room, braking, unseen, tick) + 1e-12
    assert reciprocal(room, braking, unseen + more, tick) <= half
    assert reciprocal(room - more, braking, unseen, tick) <= half


@given(ROOM, BRAKING, SPEED, SECONDS, SECONDS)
def test_no_cap_is_less_than_zero(
    room: float, braking: float, others: float, unseen: float, tick: float
) -> None:
    """So that to stand still is always feasible, and nobody is made to retreat."""
    assert passive(room, braking, others, unseen, tick) >= 0.0
    assert reciprocal(room, braking, unseen, tick) >= 0.0


def test_obstacles_may_have_been_unseen_for_different_times() -> None:
    rooms, braking, unseen = np.array([1.0, 1.0]), np.array([1.0, 1.0]), np.array([0.1, 0.5])
    both = passive_caps(rooms, braking, 0.3, unseen, 0.05)
    assert both == pytest.approx([passive(1.0, 1.0, 0.3, 0.1, 0.05), passive(1.0, 1.0, 0.3, 0.5,
                                                                             0.05)])  # fmt: skip
    assert both[1] < both[0]
