"""Drivers and their bases in every order: links that go and return, silence, commands, stops.

Two searches::

    python -m tests.sequences.drivers build/sequences flight --depth 4
    python -m tests.sequences.drivers build/sequences walk --depth 3 --driver simulated

`flight` takes the pure flight of a Crazyflie through each sequence of what may happen to it, with a
drone that falls where its motors are off. `walk` takes a driver with an emulated base through one
walk that contains each sequence of ACTIONS of that length: a de Bruijn sequence.

Rules: a base that comes back stands until a new run; a stop zeroes; a base gets no command but the
newest; a lost base is told.
"""

from __future__ import annotations

import argparse
import asyncio
import sys
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import AbstractContextManager, contextmanager, nullcontext
from dataclasses import dataclass, field
from itertools import product
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from swarmd.core.values import ZERO, Twist
from swarmd.drivers.crazyflie.flight import (
    BLIND_TIME,
    Flight,
    FlightRules,
    HoverSetpoint,
    Phase,
    Seen,
    Wish,
)
from swarmd.testing.driver_contract import (
    SETTLE_TIME,
    CollectingSink,
    DetachableRig,
    DriverHarness,
    MotorRig,
    Rig,
    running_driver,
)

# The flight of a drone

PERIOD = 0.05  # s
FALL_TIME = 2.0  # s without a set-point after which the firmware stops the motors
RULES = FlightRules(height=0.5, take_off_rate=0.5, land_rate=0.5, land_after=1.0)
TWIST = Twist(0.1, 0.5)


class BrokenRuleError(AssertionError):
    """A rule of this page does not hold."""


@dataclass(slots=True)
class DroneModel:
    """A drone in the air or on the floor, its link, and what the daemon wants."""

    flight: Flight = field(default_factory=lambda: Flight(RULES))
    now: float = 0.0
    height: float = 0.0
    are_motors_on: bool = False
    sent_at: float = 0.0  # when the last set-point arrived
    wish: Wish = Wish.HOVER
    is_linked: bool = True
    seen: dict[str, Any] = field(default_factory=dict)
    heard_at: float = 0.0
    has_rested: bool = False  # no flight was wanted since the last landing or connection

    def pass_time(self, seconds: float, period: float = PERIOD) -> None:
        """Step the flight, and judge each step."""
        for _ in range(round(seconds / period)):
            self.now += period
            self._step()

    def _step(self) -> None:
        is_known = self.is_linked and not self.seen.get("is_silent", False)
        seen = Seen(
            height=self.height if is_known else None,
            is_flying=self.are_motors_on if is_known else None,
            may_fly=is_known and not self.seen.get("is_tumbled", False),
            fault="",
            is_clear=is_known and not self.seen.get("is_near", False),
            is_battery_low=self.seen.get("is_battery_low", False),
        )
        wish = self.wish if is_known else Wish.WAIT
        if is_known:
            self.heard_at = self.now
        put = self.flight.step(self.now, wish, TWIST, seen)
        self._judge(put, wish)
        if self.is_linked and put is not None:
            self.sent_at = self.now
            self.are_motors_on, self.height = put.height > 0.0, put.height
        elif self.now - self.sent_at > FALL_TIME:
            self.are_motors_on, self.height = False, 0.0
        if self.flight.phase is Phase.GROUND:
            # Only a step with a wish not to fly is a rest; a new link begins anew.
            if not self.is_linked:
                self.has_rested = False
            elif wish in (Wish.HOVER, Wish.LAND):
                self.has_rested = True
        else:
            self.has_rested = False

    def _judge(self, put: HoverSetpoint | None, wish: Wish) -> None:
        starts = put is not None and put.height > 0.0 and not self.are_motors_on
        if starts and self.is_linked and not (self.has_rested and wish is Wish.FLY):
            raise BrokenRuleError("motors start without a run that began after the return")
        if put is not None and self.now - self.heard_at > BLIND_TIME + PERIOD:
            raise BrokenRuleError("a drone that is not heard gets a set-point")
        if put is not None and not put.twist.is_zero and wish is not Wish.FLY:
            raise BrokenRuleError("a drone moves that is not asked to")
        is_higher = put is not None and put.height > self.height + 1e-9
        if is_higher and self.are_motors_on and wish is not Wish.FLY and self.is_linked:
            raise BrokenRuleError("a drone climbs that is not asked to")


def _falls(drone: DroneModel) -> None:
    drone.is_linked = False
    drone.pass_time(4.0)


def _pauses(drone: DroneModel) -> None:
    """The daemon stands still, and goes on with what it wanted; the firmware has let go."""
    drone.now += 3.0
    drone.are_motors_on, drone.height = False, 0.0
    drone.heard_at = drone.now
    drone.has_rested = False
    drone.pass_time(1.0)


def _wishes(wish: Wish, seconds: float = 2.0) -> Callable[[DroneModel], None]:
    def act(drone: DroneModel) -> None:
        drone.wish = wish
        drone.pass_time(seconds)

    return act


def _seen(name: str, value: bool) -> Callable[[DroneModel], None]:
    def act(drone: DroneModel) -> None:
        drone.seen[name] = value
        drone.pass_time(1.0)

    return act


def _returns(drone: DroneModel) -> None:
    """A new connection, which has a flight of its own as in the driver."""
    if not drone.is_linked:
        drone.is_linked, drone.flight = True, Flight(RULES)
    drone.pass_time(2.0)


FLIGHT_ACTIONS: Mapping[str, Callable[[DroneModel], None]] = {
    "run": _wishes(Wish.FLY),
    "run for 0.3 s": _wishes(Wish.FLY, 0.3),
    "hover": _wishes(Wish.HOVER, 0.3),
    "stop": _wishes(Wish.HOVER, 3.0),
    "land": _wishes(Wish.LAND),
    "link lost": _falls,
    "link back": _returns,
    "daemon stands still": _pauses,
    "battery low": _seen("is_battery_low", True),
    "battery back": _seen("is_battery_low", False),
    "tumbled": _seen("is_tumbled", True),
    "upright": _seen("is_tumbled", False),
    "supervisor silent": _seen("is_silent", True),
    "supervisor heard": _seen("is_silent", False),
    "obstacle near": _seen("is_near", True),
    "obstacle gone": _seen("is_near", False),
}


def flights(depth: int) -> Iterator[tuple[tuple[str, ...], str]]:
    """Each sequence of `depth` actions with the rule that it breaks, empty if none."""
    for names in product(FLIGHT_ACTIONS, repeat=depth):
        drone = DroneModel()
        drone.pass_time(0.2)
        broken = ""
        try:
            for name in names:
                FLIGHT_ACTIONS[name](drone)
        except BrokenRuleError as error:
            broken = str(error)
        yield names, broken


# Drivers with emulated bases


def walk_of(actions: Sequence[str], depth: int) -> list[str]:
    """The shortest walk that contains each sequence of `depth` actions: a de Bruijn sequence.

    By the concatenation of Lyndon words (Fredricksen and Maiorana, "Necklaces of beads in k colors
    and k-ary de Bruijn sequences", 1978).

    >>> walk_of(["a", "b"], 2)
    ['a', 'a', 'b', 'b', 'a']
    """
    count = len(actions)
    word, walk = [0] * (count * depth), list[int]()

    def add(at: int, period: int) -> None:
        if at > depth:
            if depth % period == 0:
                walk.extend(word[1 : period + 1])
            return
        word[at] = word[at - period]
        add(at + 1, period)
        for letter in range(word[at - period] + 1, count):
            word[at] = letter
            add(at + 1, at)

    add(1, 1)
    return [actions[number] for number in (*walk, *walk[: depth - 1])]


class Walk:
    """A driver with its base, and what it was told last."""

    def __init__(self, harness: DriverHarness) -> None:
        assert isinstance(harness.rig, DetachableRig)
        self.harness, self.rig = harness, harness.rig
        self.is_attached = True
        self.speed = 0.1

    @property
    def sink(self) -> CollectingSink:
        """What the driver told."""
        return self.harness.sink

    def _rests(self) -> bool:
        """A drone has landed: in the air it would land first, and end this run."""
        rig = self.harness.rig
        return not isinstance(rig, MotorRig) or rig.is_at_rest()

    async def run(self) -> None:
        """The daemon commands motion, which a base that is there gets as it was sent last."""
        self.speed = 0.3 - self.speed  # another one each time
        twist, taken = Twist(self.speed), list[Twist]()
        if not self.is_attached:
            self.harness.driver.send(twist, 1, 1)
            return

        def has_come() -> bool:
            self.harness.driver.send(twist, 1, 1)
            taken.extend(self.harness.rig.commands())
            return bool(taken) and not taken[-1].is_zero

        await self.harness.until(has_come, publishing=True)
        await self.harness.until(lambda: self._gets(twist, taken), publishing=True)

    def _gets(self, twist: Twist, taken: list[Twist]) -> bool:
        self.harness.driver.send(twist, 1, 1)
        taken.extend(self.harness.rig.commands())
        return abs(taken[-1].linear - twist.linear) < 1e-6

    async def stop(self) -> None:
        """A stop: the last command is zero, and stays the last."""
        taken = list[Twist]()

        def stands() -> bool:
            self.harness.driver.send(ZERO, 2, 2, is_stopped=True)
            taken.extend(self.harness.rig.commands())
            return bool(taken) and taken[-1].is_zero and self._rests()

        if not self.is_attached:
            self.harness.driver.send(ZERO, 2, 2, is_stopped=True)
            return
        await self.harness.until(stands, publishing=True)
        await asyncio.sleep(SETTLE_TIME)
        if not all(twist.is_zero for twist in self.harness.rig.commands()):
            raise BrokenRuleError("a command follows the stop")

    async def lose(self) -> None:
        """The base goes with its links; the driver tells it, and queues nothing."""
        if self.is_attached:
            self.rig.disconnect()
            self.is_attached = False
        await self.harness.until(lambda: not self.sink.is_up)
        self.harness.driver.send(Twist(0.2), 3, 3)

    async def fall_silent(self) -> None:
        """The base publishes nothing until the driver tells that it is lost."""
        await self.harness.until(lambda: not self.sink.is_up)
        self.harness.driver.send(Twist(0.2), 3, 3)

    async def come_back(self) -> None:
        """The base is there, and publishes; one that was lost stands until a command follows."""
        if not self.is_attached:
            self.rig.reconnect()
            self.is_attached = True
        was_lost = not self.sink.is_up
        rig, loop = self.harness.rig, asyncio.get_running_loop()
        if was_lost:
            await self.harness.until(self._rests)
        await self.harness.until(lambda: self.sink.is_up, publishing=True)
        if not was_lost:
            return
        rig.commands()
        end = loop.time() + SETTLE_TIME
        self.harness.driver.send(Twist(0.2), 4, 4)  # the first one must reach the base as zero

        def has_stood() -> bool:
            self.harness.driver.send(ZERO, 5, 5, is_stopped=True)
            if not self._rests() or not all(twist.is_zero for twist in rig.commands()):
                raise BrokenRuleError("a base that came back moves")
            return loop.time() >= end

        await self.harness.until(has_stood, publishing=True)


ACTIONS: Mapping[str, Callable[[Walk], Any]] = {
    "run": Walk.run,
    "stop": Walk.stop,
    "link lost": Walk.lose,
    "silent": Walk.fall_silent,
    "back": Walk.come_back,
}


def walk(rig: Rig, depth: int) -> int:
    """Take a driver of this base through each sequence of `depth` actions; how many these are."""
    names = walk_of(tuple(ACTIONS), depth)
    done = list[str]()

    async def story() -> None:
        async with running_driver(rig) as harness:
            await harness.connect()
            walker = Walk(harness)
            for name in names:
                done.append(name)
                await ACTIONS[name](walker)

    try:
        asyncio.run(story())
    except (AssertionError, TimeoutError) as error:
        text = f"{type(error).__name__} {error}".rstrip()
        raise BrokenRuleError(f"{text} after {', '.join(done[-2 * depth :])}") from error
    count: int = len(ACTIONS) ** depth
    return count


@contextmanager
def _ros1() -> Iterator[Rig]:
    from tests.drivers.ros1.rig import RosRobot
    from tests.support.roscore import RosCore

    with TemporaryDirectory() as folder, RosCore(Path(folder)) as core:
        yield RosRobot(core)


def _simulated() -> AbstractContextManager[Rig]:
    from tests.drivers.test_simulated import Body

    return nullcontext(Body())


def _crazyflie() -> AbstractContextManager[Rig]:
    from tests.drivers.crazyflie.test_driver import Drone

    return nullcontext(Drone())


def _rmw_zenoh() -> AbstractContextManager[Rig]:
    from tests.drivers.ros2.robots import ZenohRobot

    return nullcontext(ZenohRobot())


def _ros2dds() -> AbstractContextManager[Rig]:
    from tests.drivers.ros2.robots import BridgedRobot

    return nullcontext(BridgedRobot())


DRIVERS: Mapping[str, Callable[[], AbstractContextManager[Rig]]] = {
    "simulated": _simulated,
    "crazyflie": _crazyflie,
    "rmw_zenoh": _rmw_zenoh,
    "ros2dds": _ros2dds,
    "ros1": _ros1,
}
"""The emulated base of each driver that owns its base; the replay driver has none."""


def main(folder: Path, arguments: Sequence[str]) -> int:
    """Search; 1 if a rule was broken. Nothing is kept in `folder`."""
    del folder
    parser = argparse.ArgumentParser(prog="python -m tests.sequences drivers", description=__doc__)
    parser.add_argument("what", choices=("flight", "walk"))
    parser.add_argument("--depth", type=int, default=3)
    parser.add_argument("--driver", choices=DRIVERS, action="append")
    given = parser.parse_args(arguments)
    if given.what == "flight":
        count, broken = 0, 0
        for names, text in flights(given.depth):
            count += 1
            if text:
                broken += 1
                print(f"{', '.join(names)}: {text}")
        print(f"{count} sequences of {len(FLIGHT_ACTIONS)} actions, {broken} break a rule")
        return int(broken > 0)
    for driver in given.driver or DRIVERS:
        with DRIVERS[driver]() as rig:
            print(f"{driver}: {walk(rig, given.depth)} sequences, none breaks a rule", flush=True)
    return 0


if __name__ == "__main__":
    sys.exit(main(Path(sys.argv[1]), sys.argv[2:]))
