"""A robot of a crowd that is restored from its memory goes on as the robot does, to the bit."""

from __future__ import annotations

from collections import Counter
from random import Random

import pytest

from swarmd.core.events import Input, decode_input, encode_input
from swarmd.daemon.recording import frames
from swarmd.robot.actions import Actions
from swarmd.robot.memory import recall, remember
from swarmd.robot.robot import Robot
from swarmd.sim.scenarios.scenariofile import scenario_of
from tests.support.clocked_crowd import clocked_crowd, crowd
from tests.support.examples import part

INPUTS = 200
UPTIMES = (60.0, 600.0, 86_400.0)


def bits(robot: Robot, actions: Actions | None) -> bytes:
    """Everything about a decision that a recording holds, and what else the shell does."""
    if actions is None:
        return b""
    entry = frames.DecisionEntry(0.0, "", robot.state, str(robot.reason), actions.decision)
    rest = [
        actions.requested_scan_seq,
        actions.is_idle,
        actions.is_stopped,
        actions.is_quiet,
        actions.has_status,
        actions.ended,
        sorted(actions.messages),
        type(actions.host).__name__,
        [reply.code for reply in actions.replies],
    ]
    return frames.encode(entry) + repr(rest).encode()


class Twin:
    """Steps a robot and one restored from its memory, which is replaced after INPUTS inputs."""

    def __init__(self, seed: int) -> None:
        self.compared: Counter[str] = Counter()
        self._draws = Random(seed)
        self._twins: dict[str, Robot] = {}  # by robot and instance
        self._left: dict[str, int] = {}

    def take(self, robot: Robot, input: Input, now: float) -> Actions | None:
        key = f"{robot.id} {robot._lifecycle.identity.instance}"
        left = self._left.setdefault(key, self._draws.randrange(INPUTS))
        if left == 0:
            self._twins[key] = recall(remember(robot), robot._lifecycle.identity.setup)
        self._left[key] = (left or INPUTS) - 1
        copy = decode_input(encode_input(input))
        actions = robot.step(input, now)
        twin = self._twins.get(key)
        if twin is not None:
            where = f"{robot.id} at {now!r}, {self._left[key]} inputs before its next memory"
            assert bits(twin, twin.step(copy, now)) == bits(robot, actions), where
            assert twin.wake_at(now) == robot.wake_at(now), where
            self.compared[robot.id] += 1
            self.compared["active"] += robot.decision.is_active
            self.compared["avoids"] += robot.decision.avoided is not None
            self.compared["fenced"] += robot.decision.is_bounded
            self._look_at(robot, now)
        return actions

    def _look_at(self, robot: Robot, now: float) -> None:
        """Ask the robot alone for what viewers see, at instants that no input has."""
        later = now + 1e-3 * self._draws.random()
        match self._draws.randrange(20):
            case 0:
                robot.status(later), robot.motion(later), robot.shared_pose(later)
            case 1:
                robot.tracks(later), robot.shown_decision(later), robot.pose_to_tell(later)
            case 2:
                robot.wake_at(later), robot.aged_latches(later)


@pytest.mark.short_rows(1)
@pytest.mark.parametrize("seed", part(range(2), range(2, 20)))
def test_a_robot_goes_on_from_its_memory_to_the_bit(seed: int) -> None:
    twin = Twin(seed)
    scenario = scenario_of(crowd(4 + seed % 4, 15.0))
    with clocked_crowd(scenario, seed, twin.take, uptime=UPTIMES[seed % 3]) as run:
        run.advance(15.0)
    assert min(twin.compared[robot] for robot in run.world.ids) > 5 * INPUTS / 2
    assert min(twin.compared[what] for what in ("active", "avoids", "fenced")) > 0
