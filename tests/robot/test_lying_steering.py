"""Protection decides last: whatever steering answers, the robot keeps its limits and its holds."""

from __future__ import annotations

import math
from collections.abc import Callable
from functools import partial
from typing import Any

import pytest

from swarmd.core.avoided import Avoided
from swarmd.core.messages import Reason, State
from swarmd.core.values import Twist
from swarmd.robot.protection.decision import Decision, Steered
from swarmd.robot.robot import Robot
from swarmd.settings.platforms import load_platform
from tests.support.robot_harness import RobotHarness
from tests.support.stub_patterns import Forward

BURGER = load_platform("burger")
FAST = Twist(9.9, 9.9, 9.9)


class Liar:
    """Steering that gives the same answer at each call, or raises it."""

    must_track = False

    def __init__(self, answer: object, *_: object) -> None:
        self.answer = answer

    def observe(self, *_: object) -> None:
        pass

    def on_odometry(self, *_: object) -> None:
        pass

    def tracks(self, _: object) -> None:
        return None

    def steer(self, *_: object) -> Any:
        if isinstance(self.answer, BaseException):
            raise self.answer
        return self.answer


class Mute(Exception):
    """An error whose text raises an error."""

    def __str__(self) -> str:
        raise RuntimeError


def with_steering(answer: object) -> RobotHarness:
    def make(*args: Any, make_steering: object, **keywords: Any) -> Robot:
        return Robot(*args, make_steering=partial(Liar, answer), **keywords)

    return RobotHarness("burger", patterns={"forward": Forward}, make=make)


def decision(twist: Twist) -> Decision:
    return Decision("off", twist, twist, None, False, (), None, None, -1)


WRONG: dict[str, object] = {
    "a decision": decision(FAST),
    "a command": FAST,
    "a text": "ahead",
    "true": True,
    "no command": Steered(None),  # type: ignore[arg-type]  # on purpose
    "a list": Steered([9.9, 9.9]),  # type: ignore[arg-type]  # on purpose
    "a text as speed": Steered(Twist("9.9")),  # type: ignore[arg-type]  # on purpose
    "a huge number": Steered(Twist(10**400)),
    "nan": Steered(Twist(math.nan, 0.0)),
    "infinite": Steered(Twist(0.1, math.inf)),
    "nan to the left": Steered(Twist(0.1, 0.0, math.nan)),
    "infinite ahead": Steered(Twist(-math.inf)),
    "infinite to the left": Steered(Twist(0.1, 0.0, math.inf)),
    "no bool": Steered(Twist(0.1), "yes"),  # type: ignore[arg-type]  # on purpose
    "avoids a text": Steered(Twist(0.1), False, "wall"),  # type: ignore[arg-type]  # on purpose
    "avoids nan": Steered(Twist(0.1), False, Avoided(math.nan, 1.0)),
    "avoids what has no end": Steered(Twist(0.1), False, Avoided(0.0, math.inf)),
    "avoids in no way": Steered(Twist(0.1), False, Avoided(0.0, 1.0, "left")),  # type: ignore[arg-type]  # on purpose
    "raises": ValueError("a line\nand a second one"),
    "raises a lookup": KeyError(3),
    "raises without a text": Mute(),
}
RIGHT: dict[str, object] = {
    "fast": Steered(FAST, True),
    "fast back": Steered(Twist(-9.9, -9.9, -9.9)),
    "avoids an object": Steered(FAST, False, Avoided(0.1, 1.0)),
    "none": None,
}


@pytest.mark.parametrize("answer", [*WRONG.values(), *RIGHT.values()], ids=[*WRONG, *RIGHT])
def test_steering_moves_no_robot_that_was_not_asked(answer: object) -> None:
    harness = with_steering(answer)
    harness.advance(0.5)
    assert harness.status.state is State.IDLE
    assert all(twist.is_zero for _, twist in harness.commands)


@pytest.mark.parametrize("answer", WRONG.values(), ids=WRONG)
def test_a_robot_stands_while_steering_gives_no_answer_that_can_be_used(answer: object) -> None:
    harness = with_steering(answer)
    harness.advance(0.5)
    harness.applied("run", pattern="forward")
    harness.advance(1.0)
    assert harness.status.state is State.RUNNING
    assert harness.status.reason is Reason.PROTECTION
    assert all(twist.is_zero for _, twist in harness.commands)
    log = [event.text for event in harness.status.events]
    told = [text for text in log if text.startswith("steering failed")]
    assert 0 < len(told) <= 10


@pytest.mark.parametrize("answer", RIGHT.values(), ids=RIGHT)
def test_what_steering_asks_is_kept_within_the_limits(answer: object) -> None:
    harness = with_steering(answer)
    harness.advance(0.5)
    harness.applied("run", pattern="forward")
    harness.advance(1.0)
    twists = [twist for _, twist in harness.commands]
    assert not twists[-1].is_zero
    assert max(abs(twist.linear) for twist in twists) <= BURGER.limits.linear
    assert max(abs(twist.angular) for twist in twists) <= BURGER.limits.angular
    assert all(twist.lateral == 0.0 for twist in twists)


def stop(harness: RobotHarness) -> None:
    harness.applied("stop")


def estop(harness: RobotHarness) -> None:
    harness.applied("estop")


@pytest.mark.parametrize("end", [stop, estop])
@pytest.mark.parametrize("answer", [*WRONG.values(), *RIGHT.values()], ids=[*WRONG, *RIGHT])
def test_steering_ends_no_stop(answer: object, end: Callable[[RobotHarness], None]) -> None:
    harness = with_steering(answer)
    harness.advance(0.5)
    harness.applied("run", pattern="forward")
    harness.advance(0.5)
    end(harness)
    harness.commands.clear()
    harness.advance(1.0)
    assert harness.commands
    assert all(twist.is_zero for _, twist in harness.commands)
