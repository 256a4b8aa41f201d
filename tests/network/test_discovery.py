"""Putting the swarm together from what each daemon says."""

from __future__ import annotations

import pytest

from swarmd.core.messages import Condition, Member, PeerView
from swarmd.network.discovery import QUIET, Gathering
from tests.support.fake_daemon import light_status

ALIVE, LEFT, FAILED = Condition.ALIVE, Condition.LEFT, Condition.FAILED


def member(robot: str, condition: Condition = ALIVE, *, instance: str = "1", age: float = 5.0):  # type: ignore[no-untyped-def]
    return Member(robot=robot, instance=instance, condition=condition, age=age)


def view(
    robot: str, *others: Member, instance: str = "1", roster: tuple[str, ...] = ()
) -> PeerView:
    return PeerView(
        robot=robot, status=light_status(robot, instance), members=others, roster=roster
    )


@pytest.fixture
def gathering() -> Gathering:
    return Gathering(0.0)


def test_nothing_is_never_complete(gathering: Gathering) -> None:
    assert not gathering.is_complete(10.0)
    assert gathering.result(10.0).members == {}


def test_one_answer_is_believed_only_after_quiet(gathering: Gathering) -> None:
    gathering.on_view(view("a"), 0.02)
    assert not gathering.is_complete(0.02 + QUIET / 2)
    assert gathering.is_complete(0.021 + QUIET)


@pytest.mark.parametrize("news", ["link", "token"])
def test_news_makes_the_quiet_start_again(gathering: Gathering, news: str) -> None:
    gathering.on_view(view("a"), 0.02)
    if news == "link":
        gathering.on_link(0.1)
    else:
        gathering.on_token("a", "1", True, 0.1)
    assert not gathering.is_complete(0.15)
    assert gathering.is_complete(0.101 + QUIET)


def test_answers_that_agree_are_believed_at_once(gathering: Gathering) -> None:
    gathering.on_view(view("a", member("b")), 0.01)
    gathering.on_view(view("b", member("a")), 0.02)
    assert gathering.is_complete(0.02)


def test_answers_that_do_not_know_each_other_are_not(gathering: Gathering) -> None:
    gathering.on_view(view("a", member("b")), 0.01)
    gathering.on_view(view("b"), 0.02)
    assert not gathering.is_complete(0.02)
    assert gathering.is_complete(0.021 + QUIET)


def test_whoever_a_daemon_calls_alive_must_answer(gathering: Gathering) -> None:
    gathering.on_view(view("a", member("b")), 0.01)
    assert not gathering.is_complete(10.0)
    result = gathering.result(1.0)
    assert not result.is_complete
    assert result.alive == ("a", "b")
    assert result.silent == ("b",)


def test_whoever_holds_a_token_must_answer(gathering: Gathering) -> None:
    gathering.on_view(view("a"), 0.01)
    gathering.on_token("b", "1", True, 0.02)
    assert not gathering.is_complete(10.0)
    assert gathering.result(1.0).silent == ("b",)


def test_whose_token_went_need_not_answer(gathering: Gathering) -> None:
    gathering.on_view(view("a", member("b")), 0.01)
    gathering.on_token("b", "1", True, 0.02)
    gathering.on_token("b", "1", False, 0.03)
    assert gathering.is_complete(0.031 + QUIET)
    assert gathering.result(1.0).members["b"].condition is FAILED


def test_each_speaks_for_itself(gathering: Gathering) -> None:
    gathering.on_view(view("a", member("b", age=7.0)), 0.01)
    gathering.on_view(view("b", member("a", FAILED), instance="9"), 0.02)
    result = gathering.result(1.0)
    assert result.members["b"].status == light_status("b", "9")
    assert result.members["b"].age == 7.0
    assert result.members["a"].condition is ALIVE
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
def test_peers_that_disagree_on_a_third(
    gathering: Gathering, words: tuple[Member, Member], truth: Condition
) -> None:
    gathering.on_view(view("a", words[0]), 0.01)
    gathering.on_view(view("b", words[1]), 0.02)
    assert gathering.result(1.0).members["x"].condition is truth


def test_the_roster_is_everyones(gathering: Gathering) -> None:
    gathering.on_view(view("a", roster=("a", "b")), 0.01)
    gathering.on_view(view("b", roster=("c",)), 0.01)
    result = gathering.result(1.0)
    assert result.roster == {"a", "b", "c"}
    assert result.absent == ("c",)
    assert gathering.known == {"a", "b", "c"}


def test_two_daemons_with_one_id_show(gathering: Gathering) -> None:
    gathering.on_view(view("a", instance="1"), 0.01)
    gathering.on_view(view("a", instance="2"), 0.02)
    assert gathering.result(1.0).duplicates == {"a": ("1", "2")}


def test_both_daemons_of_one_id_must_answer(gathering: Gathering) -> None:
    gathering.on_view(view("a", member("b"), instance="1"), 0.01)
    gathering.on_view(view("b", member("a")), 0.01)
    gathering.on_token("a", "1", True, 0.01)
    gathering.on_token("a", "2", True, 0.01)
    assert not gathering.is_complete(10.0)
    assert gathering.result(1.0).duplicates == {"a": ("1", "2")}
    gathering.on_view(view("a", member("b"), instance="2"), 0.02)
    assert gathering.is_complete(0.02)


def test_a_peer_that_knows_of_two_makes_both_be_waited_for(gathering: Gathering) -> None:
    gathering.on_view(view("a", member("b"), instance="1"), 0.01)
    gathering.on_view(view("b", member("a", instance="1"), member("a", instance="2")), 0.01)
    assert not gathering.is_complete(10.0)
    assert gathering.result(1.0).duplicates == {"a": ("1", "2")}
