"""The goal that an operator sets next."""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
from msgspec.structs import replace

from swarmd.core.errors import ConfigError
from swarmd.core.goal import MAX_UNSIGNED, GoalState, GoalStatus, signed_part
from swarmd.link.keys.authority import Authority
from swarmd.link.keys.content_signature import Purpose, is_signed_by
from swarmd.link.keys.identity import load_identity
from swarmd.link.keys.roster import Role
from swarmd.operator.session.members_view import MembersView
from swarmd.operator.session.session import (
    MAX_GENERATION,
    next_goal,
    signed_again,
    signed_goals,
)
from tests.support.goals import goal_status, member_with, view_of
from tests.support.keys import SwarmKeys


def operator(identity: Any = None, name: str = "anna") -> Any:
    """What a goal needs of an operator."""
    return SimpleNamespace(name=name, identity=identity)


def seen(generation: int) -> MembersView:
    """A look that found a goal of this generation."""
    return MembersView({}, goal_generation=generation)


def test_the_next_goal_is_greater_than_all_that_were_seen() -> None:
    goal = next_goal(operator(), seen(6), pattern="drive")
    assert (goal.generation, goal.issuer, goal.signature) == (7, "anna", b"")
    assert next_goal(operator(name="x" * 100), seen(0)).issuer == "x" * 63


def test_after_the_last_generation_there_is_none() -> None:
    assert next_goal(operator(), seen(MAX_GENERATION - 1)).generation == MAX_GENERATION
    with pytest.raises(ConfigError, match=str(MAX_GENERATION)):
        next_goal(operator(), seen(MAX_GENERATION))


def test_a_goal_that_no_datagram_carries_is_refused() -> None:
    with pytest.raises(ConfigError, match="fewer targets"):
        next_goal(operator(), seen(0), targets=tuple(f"robot-{n:04d}" for n in range(120)))


def test_where_keys_are_in_force_the_operator_signs_each_goal(tmp_path: Path) -> None:
    authority = Authority.create(tmp_path / "authority", "meadow")
    roster = authority.change(add={"anna": Role.OPERATOR})
    authority.issue("anna").write(tmp_path / "identity")
    me = operator(load_identity(tmp_path / "identity"))
    goal = next_goal(me, seen(1), pattern="drive")
    again = signed_again(me, goal, generation=5)
    assert again.id == goal.id
    for one in (goal, again):
        assert is_signed_by(roster.operators["anna"], Purpose.GOAL, signed_part(one), one.signature)
    assert not is_signed_by(
        roster.operators["anna"], Purpose.GOAL, signed_part(again), goal.signature
    )


def test_a_robot_that_was_taken_over_cannot_use_up_the_generations(tmp_path: Path) -> None:
    keys = SwarmKeys(tmp_path, "meadow", ["r1"], operators=["anna"])
    me = operator(keys["anna"])
    good = next_goal(me, seen(MAX_UNSIGNED), pattern="drive")
    assert good.generation == MAX_UNSIGNED + 1
    false = replace(good, generation=MAX_GENERATION)
    view = view_of(
        member_with("r1", goal_status(good)), member_with("r2", goal_status(false, before=false))
    )
    view = replace(view, goal_generation=MAX_GENERATION)
    assert next_goal(me, view, pattern="drive").generation == good.generation + 1
    alone = replace(view_of(member_with("r2", goal_status(false))), goal_generation=MAX_GENERATION)
    assert next_goal(me, alone, pattern="drive").generation == MAX_UNSIGNED + 1  # no signed goal
    shown = signed_goals(view, keys["anna"])
    of_r1, of_r2 = (one.status.goal for one in shown.members.values() if one.status is not None)
    assert of_r1 == goal_status(good)
    assert of_r2 == GoalStatus(state=GoalState.RUNNING)
    assert signed_goals(view, None) is view
