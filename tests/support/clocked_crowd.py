"""A crowd in lockstep whose robots read clocks of their own, as daemons on busy machines do.

::

    with clocked_crowd(scenario_of(crowd(5)), 1, take, uptime=60.0) as run:
        run.advance(10.0)

Each input of a robot goes through `take`, at an instant of the clock of this robot. The instants
count ns as CPython's `time.clock_gettime` does, come late by up to `JITTER`, and are not those of
other robots. Some readings of odometry have waited for a while, so that their instants are between
two ns.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from random import Random
from types import SimpleNamespace
from typing import Any
from unittest import mock

from swarmd import make_robot as maker
from swarmd.core.events import TICK_INPUT, Input, MessageInput, OdometryInput
from swarmd.core.values import Array, Odometry
from swarmd.robot.actions import Actions
from swarmd.robot.robot import Robot
from swarmd.sim.lockstep import lockstep
from swarmd.sim.lockstep.lockstep import Lockstep
from swarmd.sim.scenarios.scenario import Scenario

Take = Callable[[Robot, Input, float], Actions | None]
JITTER = 0.008  # s, less than a step of the world
MAX_WAIT = 0.02  # s of odometry in a socket
STEP = 2e-5  # s between two inputs of one instant of the world


def clock_reading(ns: int) -> float:
    """What CPython's `time.clock_gettime` gives for a clock that shows `ns`, in s.

    The formula of `time_clock_gettime` in Modules/timemodule.c: tv_sec + tv_nsec * 1e-9.
    """
    return ns // 10**9 + ns % 10**9 * 1e-9


class ClockedRobot:
    """A robot for a lockstep shell, with a clock that is `uptime` s ahead of the world's time."""

    def __init__(self, robot: Robot, take: Take, uptime: float, draws: Random) -> None:
        self.robot = robot
        self.uptime = uptime
        self._take = take
        self._draws = draws
        self._now = 0.0

    def __getattr__(self, name: str) -> Any:
        return getattr(self.robot, name)

    def step(self, input: Input, now: float) -> Actions | None:
        """Hand an input on at an instant of the robot's clock; `now` is the world's time in s."""
        return self._take(self.robot, input, self.clock(now))

    def clock(self, now: float) -> float:
        """An instant of the robot's clock at the world's time `now`, after all earlier ones."""
        late = self.uptime + now + JITTER * self._draws.random()
        self._now = clock_reading(round(1e9 * max(late, self._now + STEP * self._draws.random())))
        return self._now

    def take_odometry(self, odometry: Odometry, now: float) -> None:
        """Hand on a reading, of which some have waited in the robot's socket."""
        waited = MAX_WAIT * self._draws.random() if self._draws.random() < 0.3 else 0.0
        self._take(self.robot, OdometryInput(odometry), self.clock(now) - waited)

    def wake_at(self, now: float) -> float | None:
        """The next deadline, in s of the world."""
        at = self.robot.wake_at(self._now)
        return None if at is None else max(at - self.uptime, now)

    def status(self, now: float) -> Any:
        """The status at the robot's present instant."""
        return self.robot.status(self._now)

    def aged_latches(self, now: float) -> Any:
        """The latches at the robot's present instant."""
        return self.robot.aged_latches(self._now)


@contextmanager
def clocked_crowd(
    scenario: Scenario, seed: int, take: Take, *, uptime: float, apart: float = 0.0
) -> Iterator[Lockstep]:
    """A run whose robots get their inputs from `take(robot, input, now)`.

    The clocks of tb3-01, tb3-02 and so on begin at `uptime` s, `apart` s later, and so on.
    """
    draws = Random(seed)

    def made(id: str, *args: Any, now: float, **kwargs: Any) -> Any:
        own = Random(draws.random())
        ahead = uptime + apart * (int(id[-2:]) - 1)
        begin = clock_reading(round(1e9 * (ahead + now)))
        return ClockedRobot(Robot(id, *args, now=begin, **kwargs), take, ahead, own)

    core = SimpleNamespace(
        tick_many=_tick_many, odometry_many=_odometry_many, message_many=_message_many
    )
    with mock.patch.object(maker, "Robot", made), mock.patch.object(lockstep, "ticker", core):
        yield Lockstep(scenario, seed)


def _tick_many(
    robots: Sequence[Any], rows: Sequence[int], commands: Array, now: float
) -> list[tuple[int, Actions]]:
    found = []
    for place, robot in enumerate(robots):
        actions = robot.step(TICK_INPUT, now)
        twist = actions.twist
        commands[rows[place]] = twist.linear, twist.angular, twist.lateral
        if not actions.is_quiet:
            found.append((place, actions))
    return found


def _odometry_many(robots: Sequence[Any], readings: Sequence[Odometry], now: float) -> None:
    for robot, reading in zip(robots, readings, strict=True):
        if robot is not None:
            robot.take_odometry(reading, now)


def _message_many(robots: Sequence[Any], message: MessageInput, now: float) -> None:
    for robot in robots:
        if robot is not None:
            robot.step(message, now)


def crowd(count: int, seconds: float = 20.0, **more: Any) -> dict[str, Any]:
    """A scenario of Waffle Pis in a narrow room: runs, stops, a reset, another pattern, a fence.

    `more`: further keys of the scenario.
    """
    side = 1.3 * count**0.5 + 0.8
    half = 0.5 * side - 0.25
    corners = [[-half, -half], [half, -half], [half, half], [-half, half]]
    at = [share * seconds for share in (0.3, 0.4, 0.45, 0.6, 0.65, 0.7, 0.8)]
    return {
        "duration": seconds,
        "arena": {"size": [side, side], "poles": [{"at": [0.3, 0.1], "radius": 0.05}]},
        "lidar_visibility": "body",
        "platforms": {
            "waffle_pi": {"extends": "waffle_pi", "provides": ["scan", "odometry", "pose"]}
        },
        "fence": {"frame": "world", "polygon": corners},
        "groups": {"tb3": {"platform": "waffle_pi", "count": count, "pattern": "random_walk"}},
        "parameters": {
            "random_walk": {"clearance": 0.0, "straight_min": 3.0, "straight_max": 8.0},
            "attraction": {"recovery": True},
        },
        "start": {"layout": "random", "clearance": 0.1},
        "events": [
            {"at": at[0], "stop": ["tb3-01"]},
            {"at": at[1], "run": "random_walk", "targets": ["tb3-01"]},
            {"at": at[2], "estop": ["tb3-02"]},
            {"at": at[3], "reset": ["tb3-02"]},
            {"at": at[4], "run": "attraction", "targets": "all"},
            {"at": at[5], "kill": ["tb3-03"]},
            {"at": at[6], "join": ["tb3-03"]},
        ],
        **more,
    }
