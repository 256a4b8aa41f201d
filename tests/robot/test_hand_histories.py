"""Random histories of a robot with two hands: who moves it, and that a replay is equal."""

from __future__ import annotations

import random
from collections.abc import Callable

import pytest

from swarmd.core.events import HazardsInput, Input, decode_input, encode_input
from swarmd.core.hazard import Hazard, HazardKind
from swarmd.core.messages import Code, State
from swarmd.core.values import Twist
from swarmd.robot.actions import Actions
from swarmd.robot.robot import Robot
from tests.support.hand import HandOn
from tests.support.robot_harness import RobotHarness
from tests.support.stub_patterns import PATTERNS

LEASE = 0.5  # s, of docs/drive.md
TICK = 0.05  # s
STEPS = 60
SPEEDS = {"anna": 0.11, "bob": 0.13, "run": 0.2}  # m/s: the speed of a command tells whose it is


class History:
    """One robot, two drivers, and what was said. `inputs`: all that reached the robot."""

    def __init__(self, seed: int) -> None:
        self.random = random.Random(seed)
        self.inputs: list[tuple[Input, float]] = []
        self.decided: list[Twist | None] = []
        self.harness = RobotHarness("waffle_pi", PATTERNS, take=self.take)
        self.hands = {
            name: HandOn(self.harness, name, ahead)
            for name, ahead in (("anna", 70.0), ("bob", 9e4))
        }
        self.said = dict.fromkeys(self.hands, -1e9)  # s, the last command in time by hand
        self.holder = ""  # of the robot, by its answers
        self.harness.advance(1.0)

    def take(self, robot: Robot, input: Input, now: float) -> Actions | None:
        self.inputs.append((input, now))
        actions = robot.step(input, now)
        self.decided.append(None if actions is None else actions.twist)
        return actions

    def act(self) -> None:
        """Something happens, then time passes in which each command is judged."""
        acts: tuple[Callable[[], None], ...] = (
            *(self.speak,) * 8,
            *(self.take_it,) * 3,
            *(self.run, self.release, self.stop, self.estop, self.reset, self.resume, self.lift),
            *(self.late, self.forge),
        )
        self.random.choice(acts)()
        for _ in range(self.random.choice((1, 2, 4, 14))):
            self.judge()
            self.harness.advance(TICK)
        self.judge()

    def judge(self) -> None:
        harness = self.harness
        status = harness.status
        twist = harness.twist
        if status.driven_by:
            assert status.driven_by == self.holder
        if twist.is_zero:
            return
        assert status.state not in (State.ESTOPPED, State.FAULTED)
        speed = round(twist.linear, 6)
        if status.driven_by:  # nobody but the holder moves it, and not after the lease
            assert speed <= SPEEDS[self.holder]
            assert harness.now < self.said[self.holder] + LEASE + TICK
        else:
            assert status.state is State.RUNNING
            assert speed not in (SPEEDS["anna"], SPEEDS["bob"])

    def any_hand(self) -> HandOn:
        return self.hands[self.random.choice(("anna", "bob"))]

    def speak(self) -> None:
        hand = self.any_hand()
        hand.word(Twist(SPEEDS[hand.driver]), age=self.random.choice((0.0, 0.1)))
        self.said[hand.driver] = self.harness.now

    def late(self) -> None:
        hand = self.any_hand()
        hand.word(Twist(SPEEDS[hand.driver]), age=3.0)

    def forge(self) -> None:
        hand, other = self.any_hand(), self.any_hand()
        stolen = HandOn(self.harness, hand.driver)
        stolen.id = other.id
        stolen.ahead = other.ahead
        stolen.order = 10_000
        if hand is not other:
            stolen.word(Twist(0.3))

    def take_it(self) -> None:
        hand = self.any_hand()
        before = hand.id
        reply = hand.take()
        assert reply is not None
        if reply.code is Code.APPLIED:
            assert not self.harness.status.latches
            self.holder = hand.driver
            hand.order = 0
        else:
            hand.id = before

    def release(self) -> None:
        """A release starts no pattern that does not run."""
        was_running = self.harness.robot.is_running
        self.any_hand().release()
        assert self.harness.robot.is_running is was_running

    def run(self) -> None:
        self.harness.ask("run", pattern="forward")

    def stop(self) -> None:
        self.harness.ask("stop")
        assert self.harness.twist.is_zero
        assert not self.harness.status.driven_by

    def estop(self) -> None:
        self.harness.ask("estop")
        assert self.harness.twist.is_zero
        assert not self.harness.status.driven_by

    def reset(self) -> None:
        self.harness.ask("reset", ids=tuple(self.harness.robot.latches))

    def resume(self) -> None:
        self.harness.ask("resume")

    def lift(self) -> None:
        self.harness.step(HazardsInput((Hazard(HazardKind.LIFTED),)))
        assert self.harness.twist.is_zero
        self.harness.step(HazardsInput(()))


@pytest.mark.parametrize("seed", range(6))
def test_only_the_holder_moves_it_within_the_lease_and_a_replay_is_equal(seed: int) -> None:
    history = History(seed)
    for _ in range(STEPS):
        history.act()
    again = RobotHarness("waffle_pi", PATTERNS).robot
    first = next(n for n, (_, now) in enumerate(history.inputs) if now > 1000.0)
    for (input, now), twist in zip(history.inputs[first:], history.decided[first:], strict=True):
        actions = again.step(decode_input(encode_input(input)), now)
        assert (None if actions is None else actions.twist) == twist
