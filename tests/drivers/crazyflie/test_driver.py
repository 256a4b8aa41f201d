"""The driver, by the maker's cflib over loopback, with the emulated firmware."""

from __future__ import annotations

import asyncio
import itertools
from collections.abc import Mapping, Sequence
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
from swarmd.drivers.crazyflie.driver import make_driver
from swarmd.drivers.crazyflie.emulator import CrtpRobots
from swarmd.drivers.crazyflie.flight import LANDED_HEIGHT
from swarmd.drivers.crazyflie.link import IS_TUMBLED
from swarmd.settings.platforms import load_platform
from swarmd.testing.driver_contract import CollectingSink, DriverContract, DriverHarness, play

pytest.importorskip("cflib", reason="extra crazyflie")

PLATFORM = load_platform("crazyflie")
TWIST = Twist(0.125, 0.0, 0.0625)  # exact in single precision
QUICK = {"take_off_rate": 1.0, "land_rate": 1.0, "land_after": 1.0}


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
        odometry = Odometry(stamp, Pose(0.1, 0.2, 0.3), Twist(0.1, 0.2, 0.05))
        self.robots.publish("cf", OdometryInput(odometry))

    def publish_hazard(self, *, is_present: bool) -> None:
        self.robots.firmware("cf").faults = IS_TUMBLED if is_present else 0
        self.robots.publish_status("cf")

    def commands(self) -> Sequence[Twist]:
        taken, self._taken = self._taken, []
        return taken

    def close(self) -> None:
        self.robots.close()


class TestCrazyflieDriver(DriverContract):
    def rig(self) -> Drone:
        return Drone()


async def flying(harness: DriverHarness, drone: Drone) -> None:
    """Command motion until the drone moves at its height."""
    firmware = drone.robots.firmware("cf")
    harness.driver.send(ZERO, 1, 1)

    def flies() -> bool:
        harness.driver.send(TWIST, 1, 1)
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
        assert is_on or before <= LANDED_HEIGHT
    return bool(seen) and not seen[-1][1]


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


def test_a_drone_beside_an_obstacle_does_not_take_off() -> None:
    drone = Drone()
    drone.ranges[3] = 0.3

    async def story(harness: DriverHarness) -> None:
        firmware = drone.robots.firmware("cf")
        harness.driver.send(ZERO, 1, 1)
        harness.driver.send(ZERO, 1, 1)

        def is_told() -> bool:
            harness.driver.send(TWIST, 1, 1)
            assert not firmware.has_motors_on
            return "not clear" in harness.sink.states[-1][1]

        await harness.until(is_told, publishing=True)
        drone.ranges[3] = 2.0
        await flying(harness, drone)

    play(drone, story)


def test_a_drone_that_is_not_armed_stays_on_the_ground_and_says_so() -> None:
    drone = Drone()
    firmware = drone.robots.firmware("cf")
    firmware.is_armed = False

    async def story(harness: DriverHarness) -> None:
        harness.driver.send(ZERO, 1, 1)
        harness.driver.send(ZERO, 1, 1)

        def is_told() -> bool:
            harness.driver.send(TWIST, 1, 1)
            assert not firmware.has_motors_on
            return "not armed" in harness.sink.states[-1][1]

        await harness.until(is_told, publishing=True)
        firmware.is_armed = True  # by hand
        await flying(harness, drone)

    play(drone, story)


@pytest.mark.parametrize(
    ("firmware", "is_well", "part"),
    [
        ({}, True, "ready to fly"),
        ({"is_armed": False}, True, "not armed"),
        ({"faults": IS_TUMBLED}, False, "tumbled"),
    ],
)
def test_a_check_says_whether_the_drone_can_fly(
    firmware: dict[str, Any], is_well: bool, part: str
) -> None:
    drone = Drone()
    for name, value in firmware.items():
        setattr(drone.robots.firmware("cf"), name, value)

    async def checked() -> Finding:
        checking = asyncio.create_task(drone.make({}).check(30.0))
        while not checking.done():
            drone.publish()
            await asyncio.sleep(0.05)
        return next(row for row in checking.result() if row.subject == "supervisor")

    try:
        finding = asyncio.run(checked())
    finally:
        drone.close()
    assert finding.is_well is is_well
    assert part in finding.text


def test_a_drone_flies_on_over_a_link_that_loses_and_delays() -> None:
    drone = Drone()

    async def story(harness: DriverHarness) -> None:
        await flying(harness, drone)
        drone.robots.loss, drone.robots.delay = 0.2, 0.05
        seen = heights(drone)

        def has_flown() -> bool:
            harness.driver.send(TWIST, 2, 2)
            return len(seen) > 150

        await harness.until(has_flown, publishing=True)
        assert min(height for height, _, _ in seen) > 0.4
        assert all(is_on for _, is_on, _ in seen)
        drone.robots.loss = 0.0

    play(drone, story)


def test_the_driver_hands_over_what_the_drone_measures() -> None:
    drone = Drone()

    async def story(harness: DriverHarness) -> None:
        sink = harness.sink
        await harness.until(lambda: bool(sink.taken["readings"]), publishing=True)
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
