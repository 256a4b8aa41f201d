"""What every bus goes by."""

from __future__ import annotations

import pytest

from swarmd.core.codec import MAX_CONTROL, MAX_MESSAGE, MAX_SENSE
from swarmd.core.messages import Condition
from swarmd.network.bus import limit_of, matches, members_for_view
from swarmd.network.membership import Membership
from tests.support.fake_daemon import light_status


@pytest.mark.parametrize(
    ("name", "wanted", "is_match"),
    [
        ("vote/opinion", "vote/opinion", True),
        ("vote/opinion", "*/*", True),
        ("vote/opinion", "vote/*", True),
        ("vote/opinion", "*", False),
        ("status", "*/*", False),
        ("status", "estop", False),
    ],
)
def test_names_match_chunk_by_chunk(name: str, wanted: str, is_match: bool) -> None:
    assert matches(name, wanted) is is_match


def test_sizes_are_limited_by_plane() -> None:
    planes = ("msg", "sense", "hw", "state", "safety")
    assert [limit_of(plane) for plane in planes] == [
        MAX_MESSAGE,
        MAX_SENSE,
        MAX_SENSE,
        MAX_CONTROL,
        MAX_CONTROL,
    ]


def test_living_members_are_told_without_status_and_both_of_two() -> None:
    membership = Membership("me")
    for robot, instance in (("b", "1"), ("a", "2"), ("a", "1"), ("gone", "1")):
        membership.on_status(light_status(robot, instance), 0.0)
        membership.on_alive(robot, instance, 0.0)
    membership.on_gone("gone", "1", 1.0)
    told = members_for_view(membership, 3.0)
    assert [(member.robot, member.instance, member.condition) for member in told] == [
        ("a", "1", Condition.ALIVE),
        ("a", "2", Condition.ALIVE),
        ("b", "1", Condition.ALIVE),
        ("gone", "1", Condition.FAILED),
    ]
    assert [member.status is None for member in told] == [True, True, True, False]
    assert [member.age for member in told] == [3.0, 0.0, 3.0, 2.0]
