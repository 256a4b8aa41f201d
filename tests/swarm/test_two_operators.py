"""Two operators send requests to the same robots: one wins, the other learns its name."""

from __future__ import annotations

import re
from collections.abc import Iterator
from typing import TYPE_CHECKING

import pytest

from swarmd.core.messages import Refusal, RunRequest
from swarmd.network.operator import Operator

if TYPE_CHECKING:
    from tests.swarm.conftest import Finished, Swarm

pytestmark = pytest.mark.integration

ROBOTS = ("r1", "r2", "r3")
CHANGED_BY = re.compile(r"(?:robot changed since you looked|still loading drive), by (\w+)@\w+")
ROUNDS = 20


@pytest.fixture
def anna(swarm: Swarm) -> Iterator[Operator]:
    """Robots and an operator."""
    for robot in ROBOTS:
        swarm.start(robot)
    with Operator(swarm.settings, name="anna@desk") as made:
        yield made


@pytest.fixture
def ben(swarm: Swarm) -> Iterator[Operator]:
    """A second operator."""
    with Operator(swarm.settings, name="ben@field") as made:
        yield made


def test_the_later_operator_learns_who_changed_the_robot(anna: Operator, ben: Operator) -> None:
    looks = [(one, one.members().epochs(ROBOTS)) for one in (anna, ben)]
    first, second = (one.request(RunRequest, epochs, pattern="drive") for one, epochs in looks)
    assert first.applied == ROBOTS
    assert second.refused == ROBOTS
    assert {reply.refusal for reply in second.replies.values()} == {Refusal.STALE_EPOCH}
    assert all("anna@desk" in reply.text for reply in second.replies.values())
    assert ben.request(RunRequest, ben.members().epochs(ROBOTS), pattern="drive").applied == ROBOTS


def test_the_loser_of_two_swarmctl_learns_the_winner(swarm: Swarm) -> None:
    """Repeats until each lost a robot to a request that came between its look and its run."""
    for robot in ROBOTS:
        swarm.start(robot)
    losers: list[str] = []
    for number in range(ROUNDS):
        users = ("anna", "ben") if number % 2 else ("ben", "anna")
        begun = [swarm.begin("run", "drive", "--all", "-o", "json", user=user) for user in users]
        done = dict(zip(users, map(swarm.finish, begun), strict=True))
        for robot in ROBOTS:
            losers += losers_of(robot, done)
        for finished in done.values():
            codes = {reply["code"] for reply in finished.json["replies"].values()}
            assert finished.code == {"applied": 0, "refused": 7}.get("".join(codes), 3)
        if len(set(losers)) == 2:
            break
    print(f"after {number + 1} rounds lost: {losers}")
    assert losers


def losers_of(robot: str, done: dict[str, Finished]) -> list[str]:
    """The operators that this robot refused; the other one must be applied and named."""
    replies = {user: finished.json["replies"][robot] for user, finished in done.items()}
    losers = [user for user, reply in replies.items() if reply["code"] == "refused"]
    assert len(losers) < 2, replies
    for loser in losers:
        (winner,) = replies.keys() - {loser}
        assert replies[winner]["code"] == "applied"
        match = CHANGED_BY.match(replies[loser]["text"])
        assert match, replies
        assert match[1] == winner
    return losers
