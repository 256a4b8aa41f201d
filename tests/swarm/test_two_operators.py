"""Two operators send requests to the same robots: one wins, the other learns its name."""

from __future__ import annotations

import re
import signal
from collections.abc import Iterable
from typing import TYPE_CHECKING, Any

import pytest

from tests.support.processes import wait_until
from tests.support.swarmctl import STALLED

if TYPE_CHECKING:
    from tests.support.swarmctl import Finished, Running
    from tests.swarm.conftest import Swarm

pytestmark = pytest.mark.integration

ROBOTS = ("r1", "r2", "r3")
LOST_TO = re.compile(
    r"(?:robot changed since you looked, by|still loading drive, by|superseded while it was being"
    r" loaded: by|goal) (?:goal )?(?:\d+ of )?(\w+)@\w+"
)
ROUNDS, MAX_ROUNDS = 20, 150  # until each has lost once, or one of them at least


def test_the_loser_of_two_swarmctl_learns_the_winner(swarm: Swarm) -> None:
    """Repeats until each lost a robot to a request that came between its look and its run.

    On a busy machine the two seldom overlap.
    """
    for robot in ROBOTS:
        swarm.start(robot)
    losers: list[str] = []
    for number in range(MAX_ROUNDS):
        wait_until_one_goal_is_held(swarm)
        users = ("anna", "ben") if number % 2 else ("ben", "anna")
        begun = [begin_frozen(swarm, user) for user in users]
        for one in begun:
            one.send_signal(signal.SIGCONT)
        done = dict(zip(users, (one.finish() for one in begun), strict=True))
        texts = [reply["text"] for one in done.values() for reply in replies_of(one)]
        answered = [set(finished.json["replies"]) for finished in done.values()]
        if answered != [set(ROBOTS), set(ROBOTS)] or any(map(STALLED.search, texts)):
            continue  # the machine was too busy
        wait_until_one_goal_is_held(swarm)
        winner = issuer_of_held(swarm, ROBOTS[0])
        for robot in ROBOTS:
            losers += losers_of(robot, done, winner)
        for finished in done.values():
            codes = {reply["code"] for reply in replies_of(finished)}
            assert finished.code == {"applied": 0, "refused": 7}.get("".join(codes), 3)
        if len(set(losers)) == 2 or (losers and number >= ROUNDS):
            break
    print(f"after {number + 1} rounds lost: {losers}")
    assert losers


def begin_frozen(swarm: Swarm, user: str) -> Running:
    """A `run` by this user that is frozen at its begin, so that two can begin at once."""
    begun = swarm.begin("run", "drive", "--all", "-o", "json", user=user)
    begun.send_signal(signal.SIGSTOP)
    return begun


def wait_until_one_goal_is_held(swarm: Swarm) -> None:
    """A goal may still come from another robot after its operator has all replies."""

    def digests() -> set[str]:
        goals = [swarm.status(robot).goal for robot in ROBOTS]
        return {goal.held.digest if goal and goal.held else "" for goal in goals}

    wait_until(lambda: len(digests()) == 1, "one goal is held")


def issuer_of_held(swarm: Swarm, robot: str) -> str:
    """The user whose goal the robot holds; empty without a goal."""
    goal = swarm.status(robot).goal
    return "" if goal is None or goal.held is None else goal.held.goal.issuer.partition("@")[0]


def replies_of(finished: Finished) -> Iterable[dict[str, Any]]:
    replies: dict[str, dict[str, Any]] = finished.json["replies"]
    return replies.values()


def losers_of(robot: str, done: dict[str, Finished], winner: str) -> list[str]:
    """The operators that this robot refused, which are told the other one.

    The goal of the winner, which all robots hold in the end, may come from another robot before the
    request of the winner. The winner is then told that its own goal has changed the robot. The
    other operator was applied before, or lost its load to that goal.
    """
    replies = {user: finished.json["replies"][robot] for user, finished in done.items()}
    losers = [user for user, reply in replies.items() if reply["code"] == "refused"]
    for loser in losers:
        match = LOST_TO.match(replies[loser]["text"])
        assert match, replies
        assert match[1] != loser or loser == winner, replies
    superseded = [user for user in losers if replies[user]["text"].startswith("superseded")]
    assert len(losers) < 2 or superseded == [user for user in done if user != winner], replies
    return losers
