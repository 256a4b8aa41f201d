"""Commands to a hub that may freeze: how many are under way, and what follows them. Exact."""

from __future__ import annotations

from collections.abc import Iterable

import pytest

from swarmd.core.values import ZERO, Twist
from swarmd.drivers.ros2.command_credit import FRESH_TIME, MAX_HELD_TIME, MAX_SILENCE, CommandCredit

MOVING = Twist(0.1, -0.2)
STEP = 0.001
TICK = 0.05


class Link:
    """A daemon that commands at 20 Hz, and a hub that publishes and answers until it freezes.

    `sent`: the commands that left, with their times. `passed`: those that the hub passed on.
    """

    def __init__(
        self, *, topics: Iterable[float], round_trip: float, frozen: tuple[float, float]
    ) -> None:
        """`topics`: the periods of its topics in s; `frozen`: from when until when."""
        self.credit, self.frozen = CommandCredit(), frozen
        self.sent: list[tuple[float, Twist]] = []
        self.passed: list[tuple[float, Twist]] = []
        self.questions = 0
        self._topics, self._half = [round(1000 * period) for period in topics], 0.5 * round_trip
        self._answers: list[float] = []
        self._incoming: list[tuple[float, Twist | None]] = []

    def run(self, seconds: float) -> None:
        for count in range(round(seconds / STEP)):
            now = count * STEP
            if not self.frozen[0] <= now < self.frozen[1]:
                self._serve(now, count)
            while self._answers and self._answers[0] <= now:
                self._answers.pop(0)
                self._hear(now)
            if count % round(TICK / STEP) == 0:
                self._leave(self.credit.offer(MOVING, now), now)

    def _serve(self, now: float, count: int) -> None:
        """The hub takes in what has arrived, in order, and sends its topics."""
        while self._incoming and self._incoming[0][0] <= now:
            _, twist = self._incoming.pop(0)
            if twist is None:
                self._answers.append(now + self._half)
            else:
                self.passed.append((now, twist))
        if any(count % period == 0 for period in self._topics):
            self._answers.append(now + self._half)

    def _hear(self, now: float) -> None:
        self.credit.hear(now)
        self._leave(self.credit.release(now), now)

    def _leave(self, twist: Twist | None, now: float) -> None:
        if twist is not None:
            self.sent.append((now, twist))
            self._incoming.append((now + self._half, twist))
        if self.credit.asks(now):
            self.questions += 1
            self._incoming.append((now + self._half, None))


KINDS = pytest.mark.parametrize(
    ("topics", "round_trip"),
    [
        ((0.033, 0.2), 0.0004),
        ((0.2,), 0.0004),
        ((0.2,), 0.006),
        ((1.0,), 0.02),
        ((0.033, 0.2), 0.06),
        ((), 0.004),
    ],
    ids=["Burger", "lidar only", "Wi-Fi", "1 Hz", "slow link", "no topic"],
)


@KINDS
def test_each_tick_has_its_command_on_a_healthy_link(
    topics: tuple[float, ...], round_trip: float
) -> None:
    link = Link(topics=topics, round_trip=round_trip, frozen=(99.0, 99.0))
    link.run(2.0)
    assert len(link.sent) >= 39 * min(1.0, TICK / (round_trip + 2.0 * STEP))
    assert all(twist == MOVING for _, twist in link.sent)


@KINDS
def test_of_a_frozen_hub_comes_at_most_one_late_command_then_zero(
    topics: tuple[float, ...], round_trip: float
) -> None:
    most = 1 if round_trip < TICK else 3  # signs of life under way, each with its command
    for begin in range(1000, 1210, 3):
        freeze, thaw = STEP * (begin + 0.5), STEP * (begin + 800.5)
        link = Link(topics=topics, round_trip=round_trip, frozen=(freeze, thaw))
        link.run(2.2)
        waiting = [twist for at, twist in link.sent if freeze < at < thaw]
        burst = [twist for at, twist in link.passed if thaw < at < thaw + STEP]
        late = [twist for twist in burst if not twist.is_zero]
        assert len(late) <= most
        assert burst[len(late) :]
        assert all(twist.is_zero for twist in burst[len(late) :])
        assert sum(not twist.is_zero for twist in waiting) <= most
        assert link.passed[-1][0] == pytest.approx(2.15, abs=0.15), "it drives again"
        assert link.passed[-1][1] == MOVING


def test_of_a_hub_that_freezes_before_it_is_asked_comes_no_late_command() -> None:
    credit = CommandCredit()
    credit.hear(1.0)
    assert credit.offer(MOVING, 1.0 + FRESH_TIME + STEP) is None
    assert credit.asks(1.02)
    assert not credit.asks(1.03)


def test_a_command_that_answers_a_message_leaves_at_once_and_a_second_one_waits() -> None:
    credit = CommandCredit()
    credit.hear(1.0)
    assert credit.offer(MOVING, 1.005) == MOVING
    assert credit.offer(MOVING, 1.006) is None
    credit.hear(1.0065)
    assert credit.release(1.0065) == MOVING
    assert credit.release(1.0065) is None


def test_the_newest_command_leaves_on_the_answer() -> None:
    credit = CommandCredit()
    assert credit.offer(Twist(0.2), 1.0) is None
    assert credit.offer(MOVING, 1.05) is None
    credit.hear(1.06)
    assert credit.release(1.06) == MOVING


def test_zero_leaves_at_once_and_nothing_follows_it() -> None:
    credit = CommandCredit()
    assert credit.offer(MOVING, 1.0) is None
    assert credit.offer(ZERO, 1.01) == ZERO
    credit.hear(1.02)
    assert credit.release(1.02) is None


def test_a_command_that_waited_too_long_is_dropped() -> None:
    """As after a stall of the daemon: the answer is read before the daemon decides anew."""
    credit = CommandCredit()
    assert credit.offer(MOVING, 1.0) is None
    credit.hear(1.0 + MAX_HELD_TIME + STEP)
    assert credit.release(1.0 + MAX_HELD_TIME + STEP) is None
    assert credit.offer(MOVING, 1.0 + MAX_HELD_TIME + STEP) is None, "that sign is spent"


def test_without_an_answer_commands_are_zero_and_the_hub_is_asked_again_each_second() -> None:
    credit = CommandCredit()
    left, questions = [], 0
    for count in range(45):
        left.append(credit.offer(MOVING, 1.0 + count * TICK))
        questions += credit.asks(1.0 + count * TICK)
    silent = round(MAX_SILENCE / TICK)
    assert left[:silent] == [None] * silent
    assert left[silent + 1 :] == [ZERO] * (44 - silent)
    assert questions == 1 + 2


def test_each_bound_of_the_credit_is_included() -> None:
    """10 ms after a sign of life, 0.1 s held, 0.2 s of silence, a question a second."""
    fresh = CommandCredit()
    fresh.hear(0.0)
    assert fresh.offer(MOVING, 0.01) == MOVING

    for heard, released in ((0.1, MOVING), (0.11, None)):
        held = CommandCredit()
        assert held.offer(MOVING, 0.0) is None
        held.hear(heard)
        assert held.release(heard) == released

    silent = CommandCredit()
    assert silent.offer(MOVING, 0.0) is None
    assert silent.asks(0.0)
    assert silent.offer(MOVING, 0.2) is None
    assert silent.offer(MOVING, 0.21) == ZERO
    assert not silent.asks(0.99)
    assert silent.asks(1.0)
