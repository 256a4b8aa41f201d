"""How long a robot moves after its driver lets go: `python -m studies.hand_release`.

In virtual time a hand drives a simulated robot over a link that delays each datagram and loses
some. It lets go at a random time: by word (its stick or key is released, or it releases the robot),
or by loss (its program or its network has gone). The time is that until the robot commands zero to
its base; the way of a key to the program, and the brakes of the base, are not in it.
"""

from __future__ import annotations

import random
import statistics
from collections.abc import Iterator
from typing import NamedTuple

from swarmd.core.events import DriveInput
from swarmd.core.values import Twist
from swarmd.operator.verbs.drive.ask import Commands
from tests.support.hand import HandOn
from tests.support.robot_harness import RobotHarness

TRIES = 1000
TWIST = Twist(0.1)
TICK = 0.05  # s
STEP = 0.01  # s of the link
DRIVEN = 1.0  # s before the driver lets go, at least


class Link(NamedTuple):
    """s of a way, and the share of datagrams that get lost."""

    way: float
    loss: float


def seconds_to_zero(link: Link, is_by_word: bool, draws: random.Random) -> float | None:
    """s from the release until zero is commanded; None if the hand was lost before."""
    harness = RobotHarness("waffle_pi")
    harness.advance(0.5)
    hand = HandOn(harness, ahead=0.0)
    hand.take()
    begin = harness.now
    ends_at = begin + DRIVEN + draws.uniform(0.0, 0.2)
    commands = Commands(begin)
    under_way: list[tuple[float, DriveInput]] = []
    is_let_go = False
    now = begin
    while now < ends_at + 3.0:
        now = round(now + STEP, 6)
        if now < ends_at:
            commands.move(TWIST, 0.5, now)
        elif not is_let_go:
            is_let_go = True
            if harness.twist.is_zero:
                return None
            commands.move(Twist(), 0.1, now)
        is_sending = is_by_word or now < ends_at
        word = commands.take(now) if is_sending else None
        if word is not None and draws.random() >= link.loss:
            one = DriveInput(hand.id, hand.driver, word.order, now, word.twist)
            under_way.append((now + link.way, one))
        for at, one in [some for some in under_way if some[0] <= now]:
            harness.step(one, max(at, harness.now))
            under_way.remove((at, one))
        if now >= harness.now + TICK - 1e-9:
            harness.advance(TICK)
        if is_let_go and harness.twist.is_zero:
            stood = [at for at, twist in harness.commands if twist.is_zero and at >= ends_at]
            return stood[0] - ends_at
    raise AssertionError("it moves on")


def rows() -> Iterator[str]:
    """The rows of the table of docs/drive.md."""
    for is_by_word in (True, False):
        for link in (Link(0.0, 0.0), Link(0.2, 0.0), Link(0.2, 0.2)):
            draws = random.Random(1)
            drawn = [seconds_to_zero(link, is_by_word, draws) for _ in range(TRIES)]
            times = sorted(one for one in drawn if one is not None)
            most = times[-1]
            high = times[int(0.99 * len(times))]
            how = "word" if is_by_word else "loss"
            middle = statistics.median(times)
            cells = (f"{middle:.2f}", f"{high:.2f}", f"{most:.2f}", str(TRIES - len(times)))
            yield f"| {how} | {link.way:g} s, {link.loss:.0%} | {' | '.join(cells)} |"


if __name__ == "__main__":
    for row in rows():
        print(row, flush=True)
