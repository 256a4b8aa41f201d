"""Opinions of robots without swarmd: whose opinion reaches the pattern, and under which name."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import pytest

from swarmd.core.events import MessageInput
from swarmd.core.keys import is_id
from swarmd.core.message_limits import CHANNEL_BURST
from swarmd.core.values import Value
from swarmd.daemon.foreign_opinions import MAX_OPINION, MAX_SENDERS, ForeignOpinions
from swarmd.driver_api.opinion_link import HeardOpinion
from swarmd.network.carriers.inbound_queue import DropCounter

CHANNEL = "majority_rule/opinion"


class Rig:
    """A link of a driver, and the daemon's side of it."""

    def __init__(self, *, is_secured: bool = False, channel: str | None = CHANNEL) -> None:
        self.published: list[int] = []
        self.inputs: list[MessageInput] = []
        self.events: list[str] = []
        self.drops = DropCounter()
        self.give: Callable[[HeardOpinion], None]  # hands an opinion to the daemon
        self.now = 100.0
        self.looks = 0  # at the robots of the swarm
        self.opinions = ForeignOpinions(
            self,
            lambda: channel,
            self._robots,
            self.inputs.append,
            self.events.append,
            is_secured=is_secured,
            drops=self.drops,
            clock=lambda: self.now,
        )

    def _robots(self) -> set[str]:
        self.looks += 1
        return {"tb3-01", "tb3-02"}

    def hear(self, hear: Callable[[HeardOpinion], None]) -> None:
        self.give = hear

    def publish(self, opinion: int) -> None:
        self.published.append(opinion)


def heard(name: str, opinion: int = 1, **fields: Any) -> HeardOpinion:
    return HeardOpinion(name, opinion, fields.get("number"), fields.get("is_declared", True))


def test_an_opinion_is_a_message_of_a_name_that_no_robot_can_have() -> None:
    rig = Rig()
    rig.give(heard("tb4_07", 2))
    assert rig.inputs == [MessageInput("ros:tb4_07", CHANNEL, 2, is_program=True, size=3)]
    assert not is_id(rig.inputs[0].sender)
    rig.give(heard("tb4_07", 1))
    assert len(rig.events) == 1
    assert "not authenticated" in rig.events[0]


@pytest.mark.parametrize(
    "one", [heard("tb3_01"), heard("tb3-02"), heard("2", number=2), heard("1", number=1)]
)
def test_a_robot_of_the_swarm_votes_only_once(one: HeardOpinion) -> None:
    rig = Rig()
    rig.give(one)
    assert not rig.inputs
    assert rig.drops.counts() == {"opinion:robot": 1}


def test_a_secured_swarm_hears_declared_robots_alone_and_says_so_once() -> None:
    rig = Rig(is_secured=True)
    for name in ("tb4_08", "tb4_09", "tb4_08"):
        rig.give(heard(name, is_declared=False))
    rig.give(heard("tb4_07"))
    assert [one.sender for one in rig.inputs] == ["ros:tb4_07"]
    assert rig.drops.counts() == {"opinion:undeclared": 3}
    assert len([text for text in rig.events if "refused" in text]) == 1


@pytest.mark.parametrize("opinion", [-1, 1000, 2**31 - 1])
def test_an_opinion_out_of_bounds_is_dropped(opinion: int) -> None:
    rig = Rig()
    rig.give(heard("tb4_07", opinion))
    assert not rig.inputs
    assert rig.drops.counts() == {"opinion:malformed": 1}


def test_a_flood_of_one_sender_or_of_senders_is_cut() -> None:
    rig = Rig()
    for _ in range(100):
        rig.give(heard("tb4_07"))
    assert len(rig.inputs) == rig.looks == CHANNEL_BURST  # the list of robots may be long
    rig = Rig()
    for number in range(500):
        rig.give(heard(f"x{number}"))
    assert len(rig.inputs) == len(rig.events) == rig.looks == MAX_SENDERS
    assert rig.drops.counts() == {"opinion:full": 500 - MAX_SENDERS}


def test_without_a_voting_pattern_nothing_is_handed_on() -> None:
    rig = Rig(channel=None)
    rig.give(heard("tb4_07"))
    assert not rig.inputs


@pytest.mark.parametrize(
    ("channel", "value", "published"),
    [
        (CHANNEL, 2, [2]),
        ("majority_rule/round_vote", [5, 2, 1], [2]),
        ("vote_then_go/majority_rule/opinion", 1, [1]),
        ("beacon/place", 2, []),
        (CHANNEL, True, []),
        (CHANNEL, "2", []),
        (CHANNEL, MAX_OPINION, [MAX_OPINION]),
        (CHANNEL, MAX_OPINION + 1, []),
        (CHANNEL, 2**63, []),
        (CHANNEL, -1, []),
        ("majority_rule/round_vote", [5], []),
    ],
)
def test_the_opinion_in_a_message_of_the_own_pattern_is_published(
    channel: str, value: Value, published: list[int]
) -> None:
    rig = Rig()
    rig.opinions.on_sent(channel, value)
    assert rig.published == published
