"""Zeros against the commands of another node: at once, again and again, and to an end."""

from __future__ import annotations

import asyncio

from swarmd.core.values import ZERO, Twist
from swarmd.driver_api.command_gate import CommandGate
from swarmd.drivers.ros.zero_answers import LASTING, PERIOD, ZeroAnswers
from tests.support import hand_clock
from tests.support.stories import Tell, Test, as_test


class Base:
    """A robot that must stand, and the zeros that it gets."""

    def __init__(self) -> None:
        self.zeros = 0
        self.gate = CommandGate()
        self.gate.filter(ZERO, is_stopped=True)
        self.answers = ZeroAnswers(self.gate, self._take)

    def _take(self) -> None:
        self.zeros += 1

    async def zeros_within(self, seconds: float) -> int:
        before = self.zeros
        await asyncio.sleep(seconds)
        return self.zeros - before


def timed(tell: Tell) -> Test:
    """A test of what happens to a base, in virtual time."""
    return as_test(tell, lambda told, _: hand_clock.run(told(base=Base())), ("base",))


@timed
async def test_each_command_of_another_node_is_answered_at_once_and_again(base: Base) -> None:
    for count in (1, 2, 3):
        base.answers.answer()
        assert base.zeros == count
    assert await base.zeros_within(10.5 * PERIOD) == 10, "one repetition, not three"


@timed
async def test_zeros_end_after_the_last_command_and_begin_again(base: Base) -> None:
    for _ in range(2):
        base.answers.answer()
        await asyncio.sleep(0.5 * LASTING)
        base.answers.answer()
        assert await base.zeros_within(0.9 * LASTING) > 30
        await asyncio.sleep(0.2 * LASTING)
        assert await base.zeros_within(1.0) == 0


@timed
async def test_a_robot_that_may_move_gets_no_zeros(base: Base) -> None:
    base.answers.answer()
    base.gate.open()
    base.gate.filter(Twist(0.1))
    assert await base.zeros_within(1.0) == 0
    base.answers.answer()
    assert await base.zeros_within(1.0) == 0
