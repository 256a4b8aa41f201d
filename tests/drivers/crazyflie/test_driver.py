"""The driver, by the maker's cflib over loopback, with the emulated firmware."""

from __future__ import annotations

import asyncio
import itertools
import threading
import time
from collections.abc import Mapping, Sequence
from functools import partial
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from swarmd.core.errors import ConfigError
from swarmd.core.events import OdometryInput, ReadingsInput, ScanInput
from swarmd.core.finding import Finding
from swarmd.core.hazard import Hazard, HazardKind
from swarmd.core.messages import State
from swarmd.core.values import ZERO, Odometry, Platform, Pose, Scan, Twist, Value
from swarmd.driver_api.driver import Driver
from swarmd.drivers.crazyflie import driver as driver_module
from swarmd.drivers.crazyflie import flight as flight_module
from swarmd.drivers.crazyflie.driver import make_driver
from swarmd.drivers.crazyflie.emulator import CrtpRobots
from swarmd.drivers.crazyflie.flight import LANDED_HEIGHT
from swarmd.drivers.crazyflie.link import IS_TUMBLED
from swarmd.settings.platforms import load_platform
from swarmd.testing.driver_contract import CollectingSink, DriverContract, DriverHarness, play
from tests.support.processes import CAP

pytestmark = pytest.mark.long

UdpDriver: Any = pytest.importorskip("cflib.crtp.udpdriver", reason="extra crazyflie").UdpDriver

PLATFORM = load_platform("crazyflie")
TWIST = Twist(0.125, 0.0, 0.0625)  # exact in single precision
STALL_HEIGHT = 0.05  # m by which a tick that a stall of the machine delays lowers a landing drone
QUICK = {"take_off_rate": 1.0, "land_rate": 0.4, "land_after": 1.0}


class Drone:
    """A rig: one emulated drone."""

    platform: Platform = PLATFORM
    hazard = Hazard(HazardKind.LIFTED, "tumbled")
    hazard_options: Mapping[str, Value] = {"clear": 0.3}

    def __init__(self) -> None:
        self._stamps = itertools.count(1)
        self._taken: list[Twist] = []
        self._endpoint = "udp/127.0.0.1:0"
        self._tells_status = True
        self.ranges = np.array([1.0, 1.5, np.inf, 1.2])
        self.twist = Twist(0.1, 0.2, 0.05)  # of the state estimate
        self.reconnect()

    def make(self, options: Mapping[str, Value]) -> Driver:
        self._tells_status = options != self.hazard_options  # a rig of hazards tells these alone
        given = {**self.robots.driver_options, **QUICK, **options}
        return make_driver(swarm="s", robot="cf", platform=PLATFORM, options=given)

    def reconnect(self) -> None:
        self.robots = CrtpRobots(
            {"cf": PLATFORM}, self._endpoint, lambda robot, twist: self._taken.append(twist)
        )
        uri = self.robots.driver_options["uri"]["cf"]  # type: ignore[index,call-overload]
        self._endpoint = str(uri).replace("udp://", "udp/")

    def disconnect(self) -> None:
        self.robots.close()

    def publish(self) -> None:
        stamp = 0.1 * next(self._stamps)
        spec = PLATFORM.scan
        scan = Scan(1, stamp, self.ranges, spec.bearings, spec.range_min, spec.range_max)
        self.robots.tells_status = self._tells_status
        if self._tells_status:  # first: a driver that is up knows that the motors are off
            self.robots.publish_status("cf")
        self.robots.publish("cf", ScanInput(scan))
        odometry = Odometry(stamp, Pose(0.1, 0.2, 0.3), self.twist)
        self.robots.publish("cf", OdometryInput(odometry))

    def publish_hazard(self, *, is_present: bool) -> None:
        self.robots.firmware("cf").faults = IS_TUMBLED if is_present else 0
        self.robots.publish_status("cf")

    def commands(self) -> Sequence[Twist]:
        taken, self._taken = self._taken, []
        return taken

    def is_at_rest(self) -> bool:
        firmware = self.robots.firmware("cf")
        return not firmware.has_motors_on and firmware.height == 0.0

    def close(self) -> None:
        self.robots.close()


@pytest.fixture
def patience(monkeypatch: pytest.MonkeyPatch) -> None:
    """No stall of the machine makes a drone count as lost in flight, which then gets no set-point.

    tests/drivers/crazyflie/test_flight.py has those times.
    """
    monkeypatch.setattr(flight_module, "BLIND_TIME", CAP)
    monkeypatch.setattr(flight_module, "MAX_PAUSE", CAP)


class TestCrazyflieDriver(DriverContract):
    def rig(self) -> Drone:
        return Drone()


async def flying(harness: DriverHarness, drone: Drone) -> None:
    """Command motion until the drone moves at its height."""
    firmware, drive = drone.robots.firmware("cf"), harness.runs(TWIST)
    harness.driver.send(ZERO, 1, 1)

    def flies() -> bool:
        drive()
        return firmware.height > 0.45 and firmware.twist == TWIST

    await harness.until(flies, publishing=True)


def heights(drone: Drone) -> list[tuple[float, bool, Twist]]:
    """Height, motors and command of each tick of the emulated drone from now on."""
    firmware, seen = drone.robots.firmware("cf"), list[tuple[float, bool, Twist]]()
    tick = firmware.tick

    def ticked(now: float) -> None:
        tick(now)
        seen.append((firmware.height, firmware.has_motors_on, firmware.twist))

    firmware.tick = ticked  # type: ignore[method-assign]
    return seen


def has_landed_softly(seen: Sequence[tuple[float, bool, Twist]]) -> bool:
    """Whether the drone stands; AssertionError if it moved sideways or fell on the way down."""
    for (before, _, _), (height, is_on, twist) in itertools.pairwise(seen):
        assert height > before - 1e-9 or twist.is_zero or before - height < 1e-3
        assert is_on or before <= LANDED_HEIGHT + STALL_HEIGHT
    return bool(seen) and not seen[-1][1]


@pytest.mark.usefixtures("patience")
@pytest.mark.parametrize("cause", ["stop", "estop", "silence of the daemon", "battery", "end"])
def test_a_flying_drone_lands_softly_after(cause: str, monkeypatch: pytest.MonkeyPatch) -> None:
    drone = Drone()
    monkeypatch.setattr(driver_module, "LOW_BATTERY_TIME", 0.3)

    async def story(harness: DriverHarness) -> None:
        await flying(harness, drone)
        seen = heights(drone)
        if cause == "end":
            await harness.end()
            await harness.until(
                lambda: has_landed_softly(seen)
            )  # the last packet may be on its way
            return
        if cause == "battery":
            drone.robots.firmware("cf").set_battery(3.0)
        if cause == "estop":
            told = SimpleNamespace(state=State.ESTOPPED)
            harness.driver.show(told, None, None)  # type: ignore[attr-defined]

        def has_landed() -> bool:
            if cause != "silence of the daemon":
                moving = TWIST if cause == "battery" else ZERO
                harness.driver.send(moving, 2, 2, is_stopped=cause in ("stop", "estop"))
            return has_landed_softly(seen)

        await harness.until(has_landed, publishing=True)
        texts = " ".join(text for _, text in harness.sink.states)
        assert {"battery": "battery", "estop": "asked for"}.get(cause, "") in texts

    play(drone, story)


async def stands(harness: DriverHarness, drone: Drone, part: str) -> None:
    """Command motion until the driver tells `part` as the cause of a drone that stands."""
    firmware = drone.robots.firmware("cf")
    harness.driver.send(ZERO, 1, 1)
    harness.driver.send(ZERO, 1, 1)

    def is_told() -> bool:
        harness.driver.send(TWIST, 1, 1)
        assert not firmware.has_motors_on
        return part in harness.sink.states[-1][1]

    await harness.until(is_told, publishing=True)


def test_a_drone_flies_once_nothing_forbids_it() -> None:
    drone = Drone()
    firmware = drone.robots.firmware("cf")
    drone.ranges[3] = 0.3
    drone.twist = Twist(1.5)
    firmware.is_armed = False

    async def story(harness: DriverHarness) -> None:
        await stands(harness, drone, "not armed")
        firmware.is_armed = True  # by hand
        await stands(harness, drone, "1.50 m/s at 0.00 m")
        drone.twist = ZERO
        await stands(harness, drone, "a range is not clear")
        drone.ranges[3] = 2.0
        await flying(harness, drone)

    play(drone, story)


@pytest.mark.parametrize(
    ("deck", "cause"),
    [("bcFlow2", "no Flow deck v2"), ("bcMultiranger", "no Multi-ranger")],
)
def test_a_drone_without_a_deck_stands_and_names_the_deck(deck: str, cause: str) -> None:
    drone = Drone()
    drone.robots.firmware("cf").decks[f"deck.{deck}"] = 0
    drone.ranges[:] = -np.inf  # what the firmware reports without a Multi-ranger
    play(drone, partial(stands, drone=drone, part=f"{cause}: deck.{deck} is 0"))


def test_a_drone_with_a_pose_in_a_shared_frame_needs_no_flow_deck() -> None:
    drone = Drone()
    drone.robots.firmware("cf").decks["deck.bcFlow2"] = 0
    play(drone, partial(flying, drone=drone), pose_frame="hall")


@pytest.mark.usefixtures("patience")
def test_a_landing_that_lasts_is_left_to_the_firmware_when_the_driver_ends() -> None:
    drone = Drone()

    async def story(harness: DriverHarness) -> None:
        await flying(harness, drone)
        seen = heights(drone)
        ending = asyncio.create_task(harness.end())
        await harness.until(ending.done, publishing=True)
        assert drone.robots.firmware("cf").has_motors_on
        await harness.until(lambda: has_landed_softly(seen))

    play(drone, story, land_rate=0.15)


def test_a_send_that_fails_under_the_lock_of_the_library_hangs_nothing(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """The failure lasts longer than the period of the library's pings, which wait for the lock."""
    drone = Drone()

    def failing(self: Any, packet: object) -> None:
        time.sleep(0.25)
        if self.link_error_callback is not None:
            self.link_error_callback("refused")

    async def story(harness: DriverHarness) -> None:
        harness.driver.send(ZERO, 1, 1)
        monkeypatch.setattr(UdpDriver, "send_packet", failing)
        await harness.until(lambda: not harness.sink.is_up, publishing=True)
        assert harness.sink.states[-1][1] == "refused"
        monkeypatch.undo()
        await harness.connect()
        await harness.end()

    play(drone, story)
    waited_for = [one.name for one in threading.enumerate() if not one.daemon]
    assert waited_for == [threading.main_thread().name]


@pytest.mark.parametrize(
    ("firmware", "speed", "subject", "is_well", "part"),
    [
        ({}, 0.0, "supervisor", True, "ready to fly"),
        ({"is_armed": False}, 0.0, "supervisor", True, "not armed"),
        ({"faults": IS_TUMBLED}, 0.0, "supervisor", False, "tumbled"),
        ({"decks": {"deck.bcFlow2": 0, "deck.bcMultiranger": 1}}, 0.0, "decks", False, "Flow deck"),
        ({}, 1.5, "estimate", False, "1.50 m/s"),
    ],
)
def test_a_check_says_whether_the_drone_can_fly(
    firmware: dict[str, Any], speed: float, subject: str, is_well: bool, part: str
) -> None:
    drone = Drone()
    drone.twist = Twist(speed)
    for name, value in firmware.items():
        setattr(drone.robots.firmware("cf"), name, value)

    async def checked() -> Finding:
        for seconds in (4.0, 10.0, 30.0):  # a drone that stands still meanwhile is not heard
            checking = asyncio.create_task(drone.make({}).check(seconds))
            while not checking.done():
                drone.publish()
                await asyncio.sleep(0.05)
            found = next(row for row in checking.result() if row.subject == subject)
            if "not heard" not in found.text:
                break
        return found

    try:
        finding = asyncio.run(checked())
    finally:
        drone.close()
    assert finding.is_well is is_well
    assert part in finding.text


def test_a_drone_flies_on_over_a_link_that_loses_and_delays() -> None:
    """It lands without commands for 0.5 s: a flight of a test that stood still is flown again."""
    flights, lates = list[float](), list[float]()

    async def story(harness: DriverHarness) -> None:
        await flying(harness, drone)
        drone.robots.loss, drone.robots.delay = 0.2, 0.05
        seen, turns = heights(drone), [time.monotonic()]

        def has_flown() -> bool:
            turns.append(time.monotonic())
            harness.driver.send(TWIST, 2, 2)
            return len(seen) > 150

        await harness.until(has_flown, publishing=True)
        lates.append(max(after - before for before, after in itertools.pairwise(turns)))
        drone.robots.loss = 0.0
        lowest = min(height for height, _, _ in seen)
        if lates[-1] > 0.3 and lowest <= 0.4:
            return
        flights.append(lowest)
        assert lowest > 0.4
        assert all(is_on for _, is_on, _ in seen)

    while not flights:
        assert len(lates) < 5
        drone = Drone()
        play(drone, story)


def test_the_driver_hands_over_what_the_drone_measures() -> None:
    drone = Drone()

    async def story(harness: DriverHarness) -> None:
        sink = harness.sink
        kinds = ("readings", "scan", "odometry", "pose")
        await harness.until(lambda: all(sink.taken[kind] for kind in kinds), publishing=True)
        assert sink.scans[-1].ranges.tolist() == pytest.approx([1.0, 1.5, np.inf, 1.2])
        odometry = sink.odometries[-1]
        pose, twist = odometry.pose, odometry.twist
        assert (pose.x, pose.y, pose.yaw) == pytest.approx((0.1, 0.2, 0.3), abs=1e-5)
        assert (twist.linear, twist.angular, twist.lateral) == pytest.approx((0.1, 0.2, 0.05))
        assert sink.taken["readings"][-1]["battery"] == pytest.approx(1.0 / 1.2)
        drone.robots.publish("cf", ReadingsInput({"battery": 0.25}))  # of the simulated world
        await harness.until(
            lambda: sink.taken["readings"][-1]["battery"] == pytest.approx(0.25), publishing=True
        )
        shared = sink.taken["pose"][-1]
        assert (shared.frame, shared.error) == ("hall", 0.05)

    play(drone, story, pose_frame="hall", land_after=2.0)


def test_a_robot_without_an_address_and_a_lidar_are_refused() -> None:
    with pytest.raises(ConfigError, match="360 rays; expected 4"):
        make_driver(swarm="s", robot="cf", platform=load_platform("burger"), options={})
    made = make_driver(swarm="s", robot="cf", platform=PLATFORM, options={"uri": {"other": "x"}})
    with pytest.raises(ConfigError, match="no address of robot cf"):
        asyncio.run(made.run(CollectingSink()))


def test_without_the_library_one_line_says_what_to_install(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(driver_module, "has_cflib", lambda: False)
    made = make_driver(swarm="s", robot="cf", platform=PLATFORM, options={"uri": "udp://x:1"})
    with pytest.raises(ConfigError, match="pip install"):
        asyncio.run(made.run(CollectingSink()))
    (finding,) = asyncio.run(made.check(1.0))
    assert "cflib" in finding.text
