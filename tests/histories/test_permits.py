"""Random histories in which a name with a permit asks for all that an operator may.

The rules of all histories hold, and `permit`: nothing that this name asks reaches beyond its
permit, by no relay, goal, latch or restart.
"""

from __future__ import annotations

import random
from collections.abc import Sequence
from dataclasses import replace

import pytest

from swarmd.core.messages import Code, Reply
from swarmd.core.verbs import Request, RunRequest, StopRequest
from swarmd.link.keys.roster import KeyPermit
from tests.histories.history import HistoryStep, Steps, draw, replay, step
from tests.histories.invariants import Invariants
from tests.histories.swarm import VirtualDaemon

PUPIL = "pupil"
OWN = ("r1", "r2")
PERMITS = {
    PUPIL: KeyPermit(
        role="pupils",
        key=bytes(64),
        may=("stop r[1-2]", "run drive"),
        robots="r[1-2]",
        longest=4.0,
        speed=0.1,
        until=2**40,
    )
}
IN_SUITE, IN_EVIDENCE = range(2, 10, 2), range(10, 400, 2)  # even ones are secured
STEPS_OF_PUPIL = 6


class PermitJudge(Invariants):
    """The rules of all histories, and the rule `permit`."""

    applied = 0

    def on_reply(self, daemon: VirtualDaemon, request: Request, reply: Reply) -> None:
        """By the words of the permit: which requests of the pupil a robot may see at all."""
        super().on_reply(daemon, request, reply)
        if request.operator != PUPIL:
            return
        is_run = isinstance(request, RunRequest) and request.pattern == "drive"
        is_permitted = daemon.name in OWN and (is_run or isinstance(request, StopRequest))
        if not is_permitted or getattr(request, "goal", None) is not None:
            raise AssertionError(f"{daemon.name} sees `{request.verb}` of {PUPIL}")
        self.applied += reply.code is Code.APPLIED

    def on_event(self, daemon: VirtualDaemon) -> None:
        """No goal and no latch is of the pupil, and no other robot stands by its word."""
        super().on_event(daemon)
        robot = daemon.robot
        if robot.goal is not None and robot.goal.goal.issuer == PUPIL:
            raise AssertionError(f"{daemon.name} holds a goal of {PUPIL}")
        if any(latch.issuer == PUPIL for latch in robot.latches.values()):
            raise AssertionError(f"{daemon.name} holds a latch of {PUPIL}")
        changed_by = robot.status(self._swarm.now).changed_by
        if PUPIL in changed_by and daemon.name not in OWN:
            raise AssertionError(f"{daemon.name} has changed: {changed_by}")
        running = robot._run.running
        if running is not None and running.wish.by == PUPIL:
            left = running.finish_at - self._swarm.now
            if left > 4.0 or running.permit.speed != 0.1:
                raise AssertionError(f"{daemon.name} runs on for {left:.1f} s")


def of_pupil(chance: random.Random, robots: Sequence[str]) -> HistoryStep:
    """A step of the pupil: of all robots, or of some."""
    targets: tuple[str, ...] = ()
    if chance.random() < 0.5:
        targets = tuple(sorted(chance.sample(robots, chance.randint(1, len(robots)))))
    options = {"by": PUPIL, "targets": targets}
    kind = chance.choice(
        ("stop", "stop", "run", "run", "run", "estop", "reset", "goal", "resume", "label", "undo")
    )
    if kind == "run":
        drawn = {
            "pattern": chance.choice(("drive", "drive", "circle")),
            "has_goal": chance.random() < 0.2,
            "seconds": chance.choice((None, 2.0, 9.0)),
        }
        return step(0.3, "run", **options, **drawn)
    if kind == "undo":
        return step(0.3, "undo", by=PUPIL)
    if kind == "label":
        return step(0.3, "label", **options, labels=("red",))
    if kind == "stop" and chance.random() < 0.3:
        return step(0.3, "program_stop", **options)
    return step(0.3, kind, **options)


def drawn(seed: int) -> tuple[int, Steps]:
    """The history with this seed, with steps of the pupil among those of the others."""
    count, steps = draw(seed)
    chance = random.Random(f"permits {seed}")
    mixed = list(steps)
    robots = [f"r{number + 1}" for number in range(count)]
    for _ in range(STEPS_OF_PUPIL):
        one = replace(of_pupil(chance, robots), gap=chance.choice((0.05, 0.5, 2.0)))
        mixed.insert(chance.randint(1, len(mixed)), one)
    return count, tuple(mixed)


@pytest.mark.parametrize(
    "seed", [*IN_SUITE, *(pytest.param(seed, marks=pytest.mark.evidence) for seed in IN_EVIDENCE)]
)
def test_histories_widen_no_permit(seed: int) -> None:
    count, steps = drawn(seed)
    history = replay(count, steps, seed, permits=PERMITS, judge=PermitJudge)
    history.swarm.close()


def test_the_pupil_of_these_histories_is_obeyed_where_the_permit_permits() -> None:
    """Else the rule would hold of a swarm that refuses all."""
    steps = (
        step(1.0, "run", by=PUPIL, has_goal=False),
        step(2.0, "stop", by=PUPIL),
    )
    history = replay(3, steps, 2, permits=PERMITS, judge=PermitJudge)
    assert isinstance(history.judge, PermitJudge)
    assert history.judge.applied >= 4  # a run and a stop of each own robot
    history.swarm.close()
