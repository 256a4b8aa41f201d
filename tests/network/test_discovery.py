"""Putting the swarm together from what each daemon says."""

from __future__ import annotations

from collections.abc import Callable

import pytest

from swarmd.core.messages import Member, PeerView, Presence
from swarmd.network.discovery import QUIET_TIME, Discovery
from tests.support.fake_daemon import light_status

ALIVE, LEFT, FAILED = Presence.ALIVE, Presence.LEFT, Presence.FAILED


def member(robot: str, presence: Presence = ALIVE, *, instance: str = "1", age: float = 5.0):  # type: ignore[no-untyped-def]
    return Member(robot=robot, instance=instance, presence=presence, age=age)


def view(
    robot: str, *others: Member, instance: str = "1", roster: tuple[str, ...] = ()
) -> PeerView:
    return PeerView(
        robot=robot, status=light_status(robot, instance), members=others, roster=roster
    )


@pytest.fixture
def discovery() -> Discovery:
    return Discovery(0.0)


def test_an_empty_discovery_is_never_complete(discovery: Discovery) -> None:
    assert not discovery.is_complete(10.0)
    assert discovery.result().members == {}


def test_one_view_is_complete_only_after_the_quiet_time(discovery: Discovery) -> None:
    discovery.on_view(view("a"), 0.02)
    assert not discovery.is_complete(0.02 + QUIET_TIME / 2)
    assert discovery.is_complete(0.021 + QUIET_TIME)


@pytest.mark.parametrize(
    "news", [lambda found: found.on_link(0.1), lambda found: found.on_token("a", "1", True, 0.1)]
)
def test_news_restarts_the_quiet_time(
    discovery: Discovery, news: Callable[[Discovery], None]
) -> None:
    discovery.on_view(view("a"), 0.02)
    news(discovery)
    assert not discovery.is_complete(0.15)
    assert discovery.is_complete(0.101 + QUIET_TIME)


@pytest.mark.parametrize("do_agree", [True, False])
def test_views_that_agree_are_complete_at_once(discovery: Discovery, do_agree: bool) -> None:
    discovery.on_view(view("a", member("b")), 0.01)
    discovery.on_view(view("b", *([member("a")] if do_agree else [])), 0.02)
    assert discovery.is_complete(0.02) is do_agree
    assert discovery.is_complete(0.021 + QUIET_TIME)


@pytest.mark.parametrize("source", ["view", "token"])
def test_a_robot_that_a_view_or_token_shows_must_answer(discovery: Discovery, source: str) -> None:
    discovery.on_view(view("a", *([member("b")] if source == "view" else [])), 0.01)
    if source == "token":
        discovery.on_token("b", "1", True, 0.02)
    assert not discovery.is_complete(10.0)
    result = discovery.result()
    assert (result.alive, result.silent) == (("a", "b"), ("b",))


def test_a_robot_whose_token_vanished_need_not_answer(discovery: Discovery) -> None:
    discovery.on_view(view("a", member("b")), 0.01)
    discovery.on_token("b", "1", True, 0.02)
    discovery.on_token("b", "1", False, 0.03)
    assert discovery.is_complete(0.031 + QUIET_TIME)
    assert discovery.result().members["b"].presence is FAILED


def test_a_robots_own_status_wins_over_views_of_others(discovery: Discovery) -> None:
    discovery.on_view(view("a", member("b", age=7.0)), 0.01)
    discovery.on_view(view("b", member("a", FAILED), instance="9"), 0.02)
    result = discovery.result()
    assert result.members["b"].status == light_status("b", "9")
    assert result.members["b"].age == 7.0
    assert result.members["a"].presence is ALIVE
    assert result.epochs(["b", "zz"]) == {"b": light_status("b", "9").epoch, "zz": None}


@pytest.mark.parametrize(
    ("words", "truth"),
    [
        ((member("x", FAILED, age=1.0), member("x", ALIVE, age=9.0)), ALIVE),
        ((member("x", FAILED, age=1.0), member("x", LEFT, age=9.0)), LEFT),
        ((member("x", FAILED, age=1.0), member("x", LEFT, instance="0", age=9.0)), FAILED),
        ((member("x", FAILED, age=9.0), member("x", LEFT, instance="0", age=1.0)), LEFT),
    ],
)
def test_the_more_certain_of_two_views_of_a_robot_counts(
    discovery: Discovery, words: tuple[Member, Member], truth: Presence
) -> None:
    discovery.on_view(view("a", words[0]), 0.01)
    discovery.on_view(view("b", words[1]), 0.02)
    assert discovery.result().members["x"].presence is truth


def test_the_rosters_of_all_views_are_merged(discovery: Discovery) -> None:
    discovery.on_view(view("a", roster=("a", "b")), 0.01)
    discovery.on_view(view("b", roster=("c",)), 0.01)
    result = discovery.result()
    assert result.roster == {"a", "b", "c"}
    assert result.absent == ("c",)
    assert discovery.known == {"a", "b", "c"}


def test_both_daemons_of_one_id_must_answer(discovery: Discovery) -> None:
    discovery.on_view(view("a", member("b"), instance="1"), 0.01)
    discovery.on_view(view("b", member("a")), 0.01)
    discovery.on_token("a", "1", True, 0.01)
    discovery.on_token("a", "2", True, 0.01)
    assert not discovery.is_complete(10.0)
    assert discovery.result().duplicates == {"a": ("1", "2")}
    discovery.on_view(view("a", member("b"), instance="2"), 0.02)
    assert discovery.is_complete(0.02)


def test_both_instances_in_a_peers_view_must_answer(discovery: Discovery) -> None:
    discovery.on_view(view("a", member("b"), instance="1"), 0.01)
    discovery.on_view(view("b", member("a", instance="1"), member("a", instance="2")), 0.01)
    assert not discovery.is_complete(10.0)
    assert discovery.result().duplicates == {"a": ("1", "2")}
