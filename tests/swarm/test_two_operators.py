"""Two operators send requests to the same robots: one wins, the other learns its name."""

from __future__ import annotations

import re
from typing import TYPE_CHECKING

import pytest

if TYPE_CHECKING:
    from tests.support.swarmctl import Finished
    from tests.swarm.conftest import Swarm

pytestmark = pytest.mark.integration

ROBOTS = ("r1", "r2", "r3")
LOST_TO = re.compile(
    r"(?:robot changed since you looked, by|still loading drive, by|superseded while it was being"
    r" loaded: by|goal) (?:goal )?(?:\d+ of )?(\w+)@\w+"
)
ROUNDS = 20


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
        match = LOST_TO.match(replies[loser]["text"])
        assert match, replies
        assert match[1] == winner
    return losers
