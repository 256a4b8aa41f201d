"""Random histories over the whole table of steps: what a base does on the floor, whoever answers.

A base may have a fault, the person answers wrongly, types ahead, presses keys, pulls the cable and
closes the terminal, and another operator stops or runs the robot. The rules are checked against the
true motion of the base, not against what the dialogue was told.
"""

from __future__ import annotations

import math
import random
from collections import Counter
from dataclasses import dataclass, field
from functools import cache

import pytest

from swarmd.core.values import Pose
from swarmd.operator.acceptance.dialogue import (
    Ask,
    Begin,
    Bring,
    Closed,
    Dialogue,
    Finish,
    Judge,
    Judged,
    Keep,
    Key,
    Line,
    Sight,
    Stop,
    Tick,
)
from swarmd.operator.acceptance.step import End, Step
from swarmd.operator.acceptance.steps import steps_of
from swarmd.operator.acceptance.verdict import Result, Verdict, failed, not_shown, passed
from swarmd.operator.calibration.figures import PATTERN
from swarmd.settings.platforms import load_platform

STEPS = steps_of(load_platform("burger"))
FLIGHTS = steps_of(load_platform("crazyflie"))
SEEDS = 200
PERIOD = 0.1  # s between two sights
LEASE = 2.0  # s, as the runs of the test have
LONGEST = 1500.0  # s of a history
LATEST_REST = 4.0  # s after a history has ended: the lease, and the brakes of a base that coasts
WORDS = ("y", "y", "y", "Y", "y ", "yes", "", "n", "no", "x", "yy", "#", "#", "#", "0", "999", "q")
"""`#`: the number of a step that is drawn."""
FAULTS = ("", "late", "coasts", "ignores zero", "fast odometry", "deaf", "runaway")


@dataclass
class Base:
    """A base with its daemon: a run moves it ahead, to and fro in a calibration."""

    fault: str
    x: float = 0.0  # m, true, of the floor or of the lifted wheels
    speed: float = 0.0  # m/s
    pattern: str = ""
    wanted: float = 0.0  # m/s
    until: float = 0.0  # s
    heard: float = 0.0  # s, when the operator was heard
    renews: bool = True
    is_estopped: bool = False
    recent: list[float] = field(default_factory=list)

    def run(self, step: Step, now: float) -> None:
        motion = step.motion
        assert motion is not None
        if not self.is_estopped and self.fault != "deaf":
            self.pattern, self.until = motion.pattern, now + motion.seconds
            self.wanted, self.heard, self.renews = motion.speed, now, True

    def stop(self) -> None:
        self.pattern, self.wanted = "", 0.0

    def advance(self, now: float, is_linked: bool) -> None:
        if is_linked and self.renews:
            self.heard = now
        is_over = now > self.until and self.fault != "runaway"
        if self.pattern and (is_over or now - self.heard > LEASE):
            self.stop()
        wanted = self.wanted
        if self.pattern == PATTERN and self.fault != "runaway":
            wanted *= math.cos(2.0 * now)
        brake = 0.1 if self.fault == "coasts" else 1.0
        self.recent.append(wanted)
        if self.fault == "late":  # by 0.2 s
            wanted = self.recent[-3] if len(self.recent) > 2 else 0.0
        is_braked = not (self.fault == "ignores zero" and wanted == 0.0)
        if is_braked:
            change = max(-brake * PERIOD, min(brake * PERIOD, wanted - self.speed))
            self.speed += change
        self.x += PERIOD * self.speed


class History:
    """One history, drawn by its seed."""

    def __init__(
        self, seed: int, steps: tuple[Step, ...] = STEPS, faults: tuple[str, ...] = FAULTS
    ) -> None:
        self.random, self.steps = random.Random(seed), steps
        self.base = Base(self.random.choice(faults))
        self.now = 0.0
        self.dialogue = Dialogue(steps, self.earlier())
        self.cut_until = 0.0
        self.consent = ""  # the step whose question the person has read and answered with yes
        self.place = 0.0
        self.began: list[str] = []
        self.is_over = False
        self.judge_at = math.inf
        self.carry_out(self.dialogue.begin(0.0))

    def earlier(self) -> dict[str, Verdict]:
        """Verdicts of an earlier part: B1 passed only with a base that obeys."""
        obeys = self.base.fault != "ignores zero"
        known: dict[str, Verdict] = {}
        if self.random.random() < 0.6:
            known = {
                step.id: passed("") for step in self.steps[: self.random.randrange(len(self.steps))]
            }
        if not obeys:
            known = {name: one for name, one in known.items() if name < "B"}
        return known

    def carry_out(self, actions: object) -> None:
        assert isinstance(actions, tuple)
        for action in actions:
            match action:
                case Ask():
                    self.consent = ""
                case Begin(step=step):
                    self.began.append(step.id)
                    if step.motion is not None:
                        assert self.consent == step.id
                        self.place = self.base.x
                        if self.is_linked:
                            self.base.run(step, self.now)
                case Bring(end=End.SILENCE):
                    self.base.renews = False
                case Bring(end=End.ESTOP) if self.is_linked:
                    self.base.stop()
                    self.base.is_estopped = True
                case Stop() | Bring() if self.is_linked:
                    self.base.stop()
                case Judge(step=step):
                    if step.id == "B4":
                        self.base.is_estopped = False
                    self.judge_at = self.now + self.random.uniform(0.0, 3.0)
                case Keep(step=step):
                    self.consent = ""
                case Finish():
                    self.is_over = True

    @property
    def is_linked(self) -> bool:
        return self.now >= self.cut_until

    def person(self) -> None:
        """What the person does now, if anything."""
        draw = self.random.random()
        phase = self.dialogue.phase
        if phase == "asked" and draw < 0.06:
            number = str(self.random.randrange(len(self.steps)) + 1)
            word = self.random.choice(WORDS).replace("#", number)
            if word.strip().lower() == "y":
                self.consent = self.dialogue.step.id
            self.take(Line(word))
        elif phase != "asked" and draw < 0.006:
            self.take(Key() if draw < 0.004 else Line(self.random.choice(WORDS)))
        elif draw > 0.9998:
            self.take(Closed())
        elif draw > 0.9985:
            self.cut_until = self.now + self.random.uniform(0.2, 20.0)
        elif draw > 0.9982:
            self.base.is_estopped = True
            self.base.stop()
        elif draw > 0.998 and not self.base.is_estopped:
            self.base.stop()

    def take(self, input: object) -> None:
        self.carry_out(self.dialogue.take(input, self.now))  # type: ignore[arg-type]

    def verdict(self) -> Verdict:
        step = self.dialogue.step
        obeys = self.base.fault != "ignores zero"
        if step.id == "B1" and not obeys:
            return failed("it ignores zero")
        return self.random.choice((passed(""), passed(""), failed(""), not_shown("")))

    def advance(self) -> None:
        """One period; then the rules are checked."""
        self.now += PERIOD
        base, before = self.base, self.base.x
        base.advance(self.now, self.is_linked)
        if self.is_linked:
            scale = 1.1 if base.fault == "fast odometry" else 1.0
            self.take(Sight(base.pattern, base.is_estopped, Pose(scale * base.x, 0.0, 0.0)))
        self.take(Tick())
        self.person()
        if self.now >= self.judge_at and not self.is_over:
            self.judge_at = math.inf
            self.take(Judged(self.verdict()))
        self.check(before)

    def check(self, before: float) -> None:
        """No motion without a yes, and none beyond the announced bound."""
        step = self.dialogue.step
        motion = step.motion
        moved = abs(self.base.x - before)
        if moved == 0.0 or self.is_over or (motion is not None and motion.is_lifted):
            return
        if self.dialogue.phase not in ("moving", "resting"):
            # What the dialogue saw rest may still settle by less than a step of odometry.
            assert moved < 0.002, (step.id, self.dialogue.phase)
        assert motion is not None
        assert abs(self.base.x - self.place) <= motion.reach, step.id


@cache
def play(seed: int) -> History:
    history = History(seed)
    while not history.is_over and history.now < LONGEST:
        history.advance()
    return history


@pytest.mark.parametrize("seed", range(SEEDS))
def test_nothing_moves_without_a_yes_or_beyond_its_bound(seed: int) -> None:
    history = play(seed)
    if history.is_over and history.base.fault != "ignores zero":
        for _ in range(round(LATEST_REST / PERIOD)):
            history.now += PERIOD
            history.base.advance(history.now, is_linked=False)
        assert abs(history.base.speed) < 0.01
    if history.base.fault == "ignores zero":
        assert not [name for name in history.began if name.startswith(("C", "D"))]


def test_a_drone_that_obeys_zero_flies_within_its_bounds() -> None:
    """It has no block: one that ignores zero leaves its circle until it has landed."""
    obeying = tuple(fault for fault in FAULTS if fault != "ignores zero")
    began = Counter[str]()
    for seed in range(SEEDS):
        history = History(seed, FLIGHTS, obeying)
        while not history.is_over and history.now < LONGEST:
            history.advance()
        began.update(history.began)
    assert not [step.id for step in FLIGHTS if step.motion is not None and not began[step.id]]


def test_the_histories_reach_all_kinds_of_ends() -> None:
    """Else the test above shows nothing."""
    histories = [play(seed) for seed in range(SEEDS)]
    began = Counter(name for history in histories for name in history.began)
    moving = [step.id for step in STEPS if step.motion is not None]
    assert not [name for name in moving if not began[name]]
    results = Counter(
        verdict.result for one in histories for verdict in one.dialogue.verdicts.values()
    )
    assert min(results[result] for result in Result) > 20
    assert {history.base.fault for history in histories} == set(FAULTS)
    reasons = " ".join(
        verdict.reason for one in histories for verdict in one.dialogue.verdicts.values()
    )
    for word in ("key", "not heard", "emergency", "no", "needs"):
        assert word in reasons
