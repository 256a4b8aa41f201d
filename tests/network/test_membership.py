"""Membership: tokens and statuses in any order."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from swarmd.core.messages import Presence, Status
from swarmd.network.membership import MAX_INSTANCES, MAX_MEMBERS, Membership
from tests.support.fake_daemon import light_status

ALIVE, LEFT, FAILED = Presence.ALIVE, Presence.LEFT, Presence.FAILED


@pytest.fixture
def membership() -> Membership:
    return Membership("me")


def left(instance: str) -> Status:
    return light_status("a", instance, has_left=True)


def presence(membership: Membership, robot: str = "a") -> Presence | None:
    member = membership.member(robot, 0.0)
    return None if member is None else member.presence


def test_a_robot_that_vanishes_is_failed_and_stays_listed(membership: Membership) -> None:
    assert membership.on_alive("a", "1", 0.0)
    assert not membership.on_alive("a", "1", 1.0)
    assert membership.on_gone("a", "1", 5.0)
    member = membership.members(65.0)["a"]
    assert (member.presence, member.age) == (FAILED, 60.0)


def test_a_restarted_robot_replaces_the_failed_one(membership: Membership) -> None:
    membership.on_alive("a", "2", 0.0)
    membership.on_gone("a", "2", 1.0)
    assert membership.on_alive("a", "1", 2.0)
    member = membership.members(2.0)["a"]
    assert (member.instance, member.presence) == ("1", ALIVE)


def test_the_late_end_of_an_old_instance_does_not_fail_the_new(membership: Membership) -> None:
    membership.on_alive("a", "1", 0.0)
    membership.on_alive("a", "2", 1.0)
    membership.on_gone("a", "1", 2.0)
    member = membership.members(2.0)["a"]
    assert (member.instance, member.presence) == ("2", ALIVE)


def test_the_status_of_the_shown_instance_is_kept_after_failure(membership: Membership) -> None:
    status = light_status("a", "1")
    membership.on_alive("a", "1", 0.0)
    membership.on_status(status, 1.0)
    membership.on_status(light_status("a", "0"), 1.0)
    membership.on_gone("a", "1", 2.0)
    assert membership.members(3.0)["a"].status == status


def test_forget_removes_robots_that_are_not_alive(membership: Membership) -> None:
    membership.on_alive("a", "1", 0.0)
    assert not membership.forget("a")
    membership.on_gone("a", "1", 1.0)
    assert membership.forget("a")
    assert membership.members(2.0) == {}
    assert not membership.forget("a")


def test_the_own_robot_is_never_a_member(membership: Membership) -> None:
    assert not membership.on_alive("me", "1", 0.0)
    assert not membership.on_status(light_status("me", "1"), 0.0)
    assert membership.members(0.0) == {}


def test_a_flood_of_names_is_bounded_and_leaves_room_for_tokens(membership: Membership) -> None:
    for number in range(2 * MAX_MEMBERS):
        membership.on_status(light_status(f"ghost-{number}", "1"), 0.0)
    assert membership.on_alive("a", "1", 1.0)
    for number in range(2 * MAX_MEMBERS):
        membership.on_alive(f"ghost-{number}", "1", 1.0)
    assert len(membership.members(1.0)) == MAX_MEMBERS
    assert presence(membership) is ALIVE


def test_a_newcomer_replaces_the_robot_that_vanished_first(membership: Membership) -> None:
    membership.on_alive("old", "1", 0.0)
    for number in range(MAX_MEMBERS - 1):
        membership.on_alive(f"ghost-{number}", "1", 1.0)
        if number < 2:
            membership.on_gone(f"ghost-{number}", "1", 3.0 - number)
    membership.on_status(light_status("talker", "1"), 4.0)  # a word alone displaces nobody
    assert len(membership.members(4.0)) == MAX_MEMBERS
    assert membership.on_alive("a", "1", 4.0)
    assert membership.member("ghost-1", 4.0) is None  # it went before the other
    assert presence(membership, "ghost-0") is FAILED
    assert membership.on_alive("b", "1", 4.0)
    assert not membership.on_alive("c", "1", 4.0)  # all others are alive
    assert presence(membership, "old") is ALIVE


def test_a_flood_of_instances_is_bounded(membership: Membership) -> None:
    for number in range(1000):
        membership.on_status(left(f"x{number}"), 0.0)
        membership.on_alive("a", f"y{number}", 0.0)
    assert len(membership.duplicates["a"]) == MAX_INSTANCES


tokens = st.lists(st.sampled_from(["1", "2", "3"]), max_size=6)


@given(starts=tokens, leaving=st.sets(st.sampled_from(["1", "2", "3"])), data=st.data())
def test_the_order_of_tokens_and_statuses_does_not_matter(
    starts: list[str], leaving: set[str], data: st.DataObject
) -> None:
    """Tokens come in their own order, statuses in theirs; between the two anything goes."""
    moves: list[tuple[str, str]] = []
    there: set[str] = set()
    for instance in starts:  # each mention toggles that instance's token
        moves.append(("gone" if instance in there else "alive", instance))
        there ^= {instance}
    words = [("left", instance) for instance in sorted(leaving)]
    order = data.draw(st.permutations(["token"] * len(moves) + ["word"] * len(words)))

    mixed, plain = Membership("me"), Membership("me")
    queues = {"token": iter(moves), "word": iter(words)}
    for turn in order:
        apply(mixed, *next(queues[turn]))
    for move in moves + words:
        apply(plain, *move)

    assert state_of(mixed) == state_of(plain)
    expected_alive = there - leaving
    assert (presence(mixed) is ALIVE) == bool(expected_alive)
    assert mixed.duplicates == (
        {"a": tuple(sorted(expected_alive))} if len(expected_alive) > 1 else {}
    )


def apply(membership: Membership, event: str, instance: str) -> None:
    if event == "alive":
        membership.on_alive("a", instance, 0.0)
    elif event == "gone":
        membership.on_gone("a", instance, 0.0)
    else:
        membership.on_status(left(instance), 0.0)


def state_of(membership: Membership) -> tuple[str, Presence, bool] | None:
    member = membership.member("a", 0.0)
    if member is None:
        return None
    return member.instance, member.presence, member.status is not None
