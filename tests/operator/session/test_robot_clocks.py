"""What an operator knows of the clocks of robots: never more than they show."""

from __future__ import annotations

import pytest

from swarmd.link.datagram import Beacon
from swarmd.operator.session.clocks import ANSWER_TIME, RobotClocks

LIFE, NEXT_LIFE = b"robot1", b"robot2"
AHEAD = 500.0  # s, of the robot's clock


def answer(echo: int, clock: float, instance: bytes = LIFE) -> Beacon:
    """A beacon that answers a solicit when the robot's clock shows `clock` s."""
    return Beacon(
        robot="r1",
        instance=instance,
        sequence=1,
        wire=1,
        state=0,
        revision=0,
        echo=echo,
        clock=round(1000.0 * clock),
    )


class Exchanges:
    """An operator asks the robot, whose clock is `AHEAD`; `jump`: s by which its own has jumped."""

    def __init__(self) -> None:
        self.clocks, self.now, self.jump, self._echo = RobotClocks(), 100.0, 0.0, 0

    @property
    def here(self) -> float:
        return self.now + self.jump

    def ask(self, there: float = 0.0, back: float = 0.0, instance: bytes = LIFE) -> None:
        """Ask; the ways of the question and of the answer take so many s."""
        self._echo += 1
        self.clocks.on_solicit(self._echo, self.here)
        self.now += there
        beacon = answer(self._echo, self.now + AHEAD, instance)
        self.now += back
        self.clocks.on_beacon(beacon, self.here)

    def behind(self, instance: bytes = LIFE) -> float:
        """By how many s the reading is behind what the robot's clock shows."""
        reading = self.clocks.reading("r1", instance, self.here)
        assert reading is not None
        return self.now + AHEAD - reading / 1000.0


def test_a_reading_is_behind_by_the_way_of_the_answer_and_never_ahead() -> None:
    operator = Exchanges()
    operator.ask(there=2.0, back=0.3)
    assert operator.behind() == pytest.approx(0.3, abs=0.003)
    operator.ask(there=0.0, back=0.01)  # a better one
    assert operator.behind() == pytest.approx(0.01, abs=0.003)
    operator.ask(there=0.1, back=2.0)  # a worse one, after which the better one still counts
    assert operator.behind() == pytest.approx(0.01, abs=0.005)
    operator.now += 100.0  # clocks drift by 500e-6 at most
    assert operator.behind() == pytest.approx(0.01 + 0.05, abs=0.005)


@pytest.mark.parametrize("jump", [0.5, 3600.0, -0.5, -3600.0])
def test_after_a_jump_of_the_own_clock_the_next_answer_counts(jump: float) -> None:
    operator = Exchanges()
    operator.ask(back=0.01)
    operator.jump = jump  # as of a virtual machine that was suspended, or set back
    operator.ask(back=0.01)
    assert operator.behind() == pytest.approx(0.01, abs=0.003)


def test_a_life_that_has_not_answered_has_no_reading() -> None:
    operator = Exchanges()
    operator.ask()
    assert operator.clocks.reading("r1", NEXT_LIFE, operator.here) is None
    assert operator.clocks.reading("r2", LIFE, operator.here) is None
    operator.ask(instance=NEXT_LIFE)
    assert operator.behind(NEXT_LIFE) == pytest.approx(0.0, abs=0.003)


@pytest.mark.parametrize(
    ("echo", "clock", "later"),
    [(2, 600.0, 0.0), (0, 600.0, 0.0), (1, 600.0, ANSWER_TIME + 0.1), (1, 0.0, 0.0)],
    ids=["another number", "no answer", "too late", "no clock"],
)
def test_what_answers_no_question_shows_no_clock(echo: int, clock: float, later: float) -> None:
    clocks = RobotClocks()
    clocks.on_solicit(1, 100.0)
    clocks.on_beacon(answer(echo, clock), 100.0 + later)
    assert clocks.reading("r1", LIFE, 100.0 + later) is None
