"""A step of an acceptance test: a row of the table in `steps.py`."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from enum import StrEnum
from typing import NamedTuple

from swarmd.operator.acceptance.evidence import Evidence
from swarmd.operator.acceptance.verdict import Verdict

Judge = Callable[[Evidence], Verdict]
SLACK_TIME = 2.0
"""s at full speed that a bound of motion has for a base that stops late."""


class End(StrEnum):
    """What ends the motion of a step; `run`: the robot ends its run by itself."""

    RUN = "run"
    STOP = "stop"
    ESTOP = "estop"
    SILENCE = "silence"  # the run lease is no longer renewed, as if the laptop were gone
    PERSON = "person"  # the person kills, cuts or pulls, as `prepare` says


class Motion(NamedTuple):
    """What moves in a step, at most; it is announced before the question of the step.

    The robot runs `pattern` for `seconds`, and then ends the run by itself.
    """

    pattern: str
    params: Mapping[str, float]
    seconds: float
    speed: float  # m/s
    turn: float  # rad/s
    reach: float  # m from the place where the step begins, by odometry
    is_lifted: bool = False  # the wheels do not touch the floor
    height: float = 0.0  # m to which a drone takes off first
    end: End = End.RUN
    end_after: float = 0.0  # s of motion until the end that the dialogue brings about
    absence: float = 0.0  # s for which the robot may not be heard meanwhile
    rest: float = 0.0  # s at least from the end until the step is judged: a drone lands

    @property
    def stop_at(self) -> float:
        """The way in m at which the dialogue stops the robot, so that it rests within `reach`."""
        return self.reach - _STOP_TIME * self.speed

    @property
    def text(self) -> str:
        """The bounds in words."""
        turn = f", turns at up to {self.turn:.1f} rad/s" if self.turn else ""
        where = "its wheels are lifted and turn by" if self.is_lifted else "it moves by"
        if self.height:
            where = f"it takes off to {self.height:.2f} m, and flies by"
        return (
            f"{where} {self.reach:.2f} m at most, at up to {self.speed:.2f} m/s{turn}, for"
            f" {self.seconds:.0f} s at most"
        )


def reach_of(speed: float, seconds: float) -> float:
    """The announced bound in m of a drive at `speed` m/s that ends by itself after `seconds`."""
    return speed * (seconds + SLACK_TIME) + _SLACK


class Work(StrEnum):
    """What is done for the evidence of a step."""

    RECORD = "record"  # the robot records itself
    DOCTOR = "doctor"  # the findings of `swarmctl doctor` on the robot
    CHECK = "check"  # the findings of `swarmd --check`, on the robot itself
    RESET = "reset"  # clears the emergency stop of this test
    WRITE = "write"  # writes the measured platform file
    NOTHING = "nothing"  # earlier steps have measured all


@dataclass(frozen=True, slots=True)
class Step:
    """A step: what to prepare, what moves, what is measured, and how it is judged.

    - `id`: its part and its number, such as `B1`.
    - `why`: one sentence. `prepare`: what the person does before the answer.
    - `question`: for a step with a motion: what must be true before the robot moves.
    - `seconds`: of the measurement, in a step without a motion.
    - `of`: the step whose recording this step judges; empty: its own.
    - `needs`: steps that must have passed.
    - `is_latched`: the robot may be emergency-stopped in this step, by this test.
    """

    id: str
    name: str
    why: str
    judge: Judge
    work: Work = Work.RECORD
    prepare: str = ""
    question: str = ""
    motion: Motion | None = None
    seconds: float = 0.0
    of: str = ""
    needs: tuple[str, ...] = ()
    is_latched: bool = False

    @property
    def is_asked(self) -> bool:
        """True if the step waits for an answer; else it begins by itself, and nothing moves."""
        return self.motion is not None or bool(self.prepare)

    def reads(self, id: str) -> bool:
        """True if the step judges what the step `id` has measured, and asks nothing."""
        return not self.is_asked and (self.of == id or id in self.needs)

    @property
    def duration(self) -> float:
        """About how many s the step takes, with its preparation and its answer."""
        motion = self.motion
        moves = 0.0 if motion is None else min(motion.seconds, _USUAL_TIME)
        return self.seconds + moves + (_ANSWER_TIME if self.is_asked else 0.0)


_SLACK = 0.1  # m, for a base that stops late
_STOP_TIME = 0.7  # s of way at full speed, from a pose that is too far to rest
_ANSWER_TIME = 45.0  # s to read and to prepare: an estimate
_USUAL_TIME = 120.0  # s of a motion whose bound is longer, such as a calibration
