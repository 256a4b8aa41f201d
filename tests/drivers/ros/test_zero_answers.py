"""Zeros against the commands of another node: at once, again and again, and to an end."""

from __future__ import annotations

import asyncio

import pytest

from swarmd.core.values import ZERO, Twist
from swarmd.driver_api.command_gate import CommandGate
from swarmd.drivers.ros import zero_answers
from swarmd.drivers.ros.zero_answers import ZeroAnswers

CAP = 5.0


class Base:
    """A robot that must stand, and the zeros that it gets."""

    def __init__(self) -> None:
        self.zeros = 0
        self.gate = CommandGate()
        self.gate.filter(ZERO, is_stopped=True)
        self.answers = ZeroAnswers(self.gate, self._take)

    def _take(self) -> None:
        self.zeros += 1

    async def gets(self, count: int) -> None:
        async with asyncio.timeout(CAP):
            while self.zeros < count:
                await asyncio.sleep(0.001)

    async def gets_no_more(self) -> None:
        async with asyncio.timeout(CAP):
            before = -1
            while before < self.zeros:
                before = self.zeros
                await asyncio.sleep(10.0 * zero_answers.PERIOD)


async def test_each_command_of_another_node_is_answered_at_once_and_again() -> None:
    base = Base()
    for count in (1, 2, 3):
        base.answers.answer()
        assert base.zeros == count
    await base.gets(10)


async def test_zeros_end_after_the_last_command_and_begin_again(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(zero_answers, "LASTING", 0.02)
    base = Base()
    for _ in range(2):
        before = base.zeros
        base.answers.answer()
        await base.gets(before + 3)
        await base.gets_no_more()


async def test_a_robot_that_may_move_gets_no_zeros() -> None:
    base = Base()
    base.answers.answer()
    base.gate.open()
    base.gate.filter(Twist(0.1))
    await base.gets_no_more()
    before = base.zeros
    base.answers.answer()
    await base.gets_no_more()
    assert base.zeros == before
