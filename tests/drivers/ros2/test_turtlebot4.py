"""A stand-in TurtleBot 4, told of as its page says: a bump holds the robot, a lift ends its run."""

from __future__ import annotations

import asyncio
import re
from collections.abc import Awaitable, Callable, Mapping
from pathlib import Path
from typing import Any

import pytest
import yaml

from swarmd.core.clock import TICK
from swarmd.core.events import TICK_INPUT, DriverInput, HazardsInput, OdometryInput
from swarmd.core.hazard import Hazard
from swarmd.core.messages import Reason, State, Status
from swarmd.core.values import Odometry, Scan, Value
from swarmd.driver_api.driver import Driver
from swarmd.drivers.ros import cdr
from swarmd.drivers.ros.message_types import MessageTypes
from swarmd.drivers.ros.options import RosOptions
from swarmd.settings.platforms import load_platform
from swarmd.testing.driver_contract import TIMEOUT, CollectingSink
from tests.drivers.ros2.harness import check
from tests.drivers.ros2.robots import RAYS, BridgedRobot, odometry, scan
from tests.support.robot_harness import RobotHarness
from tests.support.stub_patterns import PATTERNS
from tests.support.vendor_messages import PACKAGE, vendor_folder

PAGE = Path(__file__).resolve().parents[3] / "docs" / "robots" / "turtlebot4.md"
BUMP, WHEEL_DROP = 1, 4


class TurtleBot4(BridgedRobot):
    """The topics of a TurtleBot 4 behind a bridge, with the options of its page."""

    platform = load_platform("turtlebot4")

    def __init__(self, folder: Path) -> None:
        super().__init__(is_stamped=True)
        text = re.search(r"^```yaml\n(.*?)^```", PAGE.read_text(), re.MULTILINE | re.DOTALL)
        assert text is not None
        given = yaml.safe_load(text[1])["driver_options"] | {"message_path": str(folder)}
        own = dict(self.platform.drivers["ros2dds"])
        del own["command_timeout"]
        self.page_options: dict[str, Value] = own | given
        self._types = MessageTypes(RosOptions.distro, [str(folder)])

    def options(self, given: Mapping[str, Value]) -> Mapping[str, Value]:
        return {**super().options({}), **self.page_options, **given}

    def publish(self) -> None:
        """What it publishes at all times, while all is well."""
        self.publish_motion()
        self.publish_hazards()
        self.publish_lifted(is_lifted=False)

    def publish_motion(self) -> None:
        """Scan and odometry alone. Scans that repeat would be those of a frozen lidar."""
        stamp = self._stamp()
        ranges = [2.0 + 0.01 * ((7 * ray + round(100.0 * stamp)) % 13) for ray in range(RAYS)]
        self.put("scan", scan(stamp, ranges))
        self.put("odom", odometry(self._stamp()))

    def publish_hazards(self, *hazards: tuple[int, str]) -> None:
        """Types and frames of hazard_detection."""
        kind = self._types.kind(f"{PACKAGE}/HazardDetection")
        found = [kind(header=self._header(frame), type=number) for number, frame in hazards]
        whole = self._types.kind(f"{PACKAGE}/HazardDetectionVector")
        self.put("hazard_detection", cdr.encode(whole(header=self._header(), detections=found)))

    def publish_lifted(self, *, is_lifted: bool) -> None:
        """The message of kidnap_status."""
        kind = self._types.kind(f"{PACKAGE}/KidnapStatus")
        self.put("kidnap_status", cdr.encode(kind(header=self._header(), is_kidnapped=is_lifted)))

    def _header(self, frame: str = "base_link") -> Any:
        sec, rest = divmod(round(self._stamp() * 1e9), 10**9)
        time = self._types.kind("builtin_interfaces/Time")(sec=sec, nanosec=rest)
        return self._types.kind("std_msgs/Header")(stamp=time, frame_id=frame)


class Daemon(CollectingSink):
    """What a daemon does: it hands what its driver tells to its robot, and ticks."""

    def __init__(self) -> None:
        super().__init__()
        self.story = RobotHarness("turtlebot4", PATTERNS)
        self._shift = self.story.now - asyncio.get_running_loop().time()

    @property
    def now(self) -> RobotHarness:
        """Its robot at the present time."""
        self.story.now = self._shift + asyncio.get_running_loop().time()
        return self.story

    def scan(self, scan: Scan) -> None:
        self.now.scan(scan)

    def odometry(self, odometry: Odometry) -> None:
        self.now.step(OdometryInput(odometry))

    def hazards(self, hazards: tuple[Hazard, ...]) -> None:
        self.now.step(HazardsInput(hazards))

    def state(
        self, is_up: bool, text: str, *, hold: Reason | None = None, gets_zero: bool = False
    ) -> None:
        self.now.step(DriverInput(is_up, text, hold, gets_zero))

    def tick(self, driver: Driver) -> None:
        """A tick; the driver gets the command."""
        story = self.now
        story.step(TICK_INPUT)
        driver.send(story.twist, 0, 0, is_stopped=story.robot.state is State.STOPPED)


class Drive:
    """A TurtleBot 4 whose daemon runs; the base publishes what `publish` gives."""

    def __init__(self, base: TurtleBot4) -> None:
        self.base, self.daemon = base, Daemon()
        self._driver = base.make({})
        self._task = asyncio.create_task(self._driver.run(self.daemon))

    @property
    def status(self) -> Status:
        """The robot's present status."""
        return self.daemon.now.status

    async def until(self, condition: Callable[[], bool], *hazards: tuple[int, str]) -> None:
        """Tick until a condition holds, while the base tells of these hazards."""
        async with asyncio.timeout(TIMEOUT):
            while not condition():
                self.base.publish_motion()
                self.base.publish_hazards(*hazards)
                self.base.publish_lifted(is_lifted=False)
                await asyncio.sleep(TICK)
                self.daemon.tick(self._driver)

    async def lift(self) -> None:
        """Tick while the base tells that it is lifted, until its run has ended."""
        async with asyncio.timeout(TIMEOUT):
            while self.status.state is not State.STOPPED:
                self.base.publish()
                self.base.publish_lifted(is_lifted=True)
                await asyncio.sleep(TICK)
                self.daemon.tick(self._driver)

    async def start(self) -> None:
        """Run forward, until the base gets a command to move."""
        robot = self.daemon.story.robot
        await self.until(lambda: robot.reason is Reason.NEVER_ASKED and robot.scan is not None)
        await self.run()

    async def run(self) -> None:
        """A new run, until the base gets a command to move."""
        assert self.daemon.now.ask("run", pattern="forward", params={"speed": 0.1}) is not None
        await self.until(self.moves)

    def moves(self) -> bool:
        """Whether the newest command at the base moves it."""
        commands = self.base.commands()
        return bool(commands) and not commands[-1].is_zero

    def stands(self) -> bool:
        """Whether the newest command at the base is zero."""
        commands = self.base.commands()
        return bool(commands) and commands[-1].is_zero

    async def end(self) -> None:
        """End driver and base."""
        self._task.cancel()
        await asyncio.gather(self._task, return_exceptions=True)
        self.base.close()


def drive(folder: Path, story: Callable[[Drive], Awaitable[None]]) -> None:
    """Play a story with a robot that drives forward."""

    async def run() -> None:
        one = Drive(TurtleBot4(folder))
        try:
            await one.start()
            await story(one)
        finally:
            await one.end()

    asyncio.run(run())


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """The share folder of the robot's ROS installation."""
    return vendor_folder(tmp_path)


def test_a_bump_holds_the_robot_until_it_is_over(folder: Path) -> None:
    async def story(one: Drive) -> None:
        bump = BUMP, "bump_front_left"
        await one.until(one.stands, bump)
        assert (one.status.state, one.status.reason) == (State.RUNNING, Reason.HAZARD)
        assert one.status.detail.startswith("bump front left, ")
        await one.until(one.moves)

    drive(folder, story)


def test_a_backup_limit_does_not_hold_it(folder: Path) -> None:
    async def story(one: Drive) -> None:
        began = one.status.uptime
        await one.until(lambda: one.status.uptime > began + 0.5, (0, "base_link"))
        await one.until(one.moves, (0, "base_link"))
        assert one.status.reason is None

    drive(folder, story)


def test_a_lift_ends_the_run_and_putting_it_down_starts_none(folder: Path) -> None:
    async def story(one: Drive) -> None:
        await one.lift()
        assert one.status.reason is Reason.HAZARD
        assert "lifted" in one.status.detail
        await one.until(one.stands)
        put_down, moved = one.status.uptime, list[bool]()

        def has_waited() -> bool:
            moved.append(one.moves())
            return one.status.uptime > put_down + 1.5

        await one.until(has_waited)
        assert not any(moved)
        await one.run()

    drive(folder, story)


def test_a_dropped_wheel_ends_the_run(folder: Path) -> None:
    async def story(one: Drive) -> None:
        dropped = WHEEL_DROP, "wheel_drop_left"
        await one.until(lambda: one.status.state is State.STOPPED, dropped)
        assert one.status.detail.startswith("wheel drop left, ")

    drive(folder, story)


def test_a_republisher_that_leaves_the_hazards_out_holds_the_robot(folder: Path) -> None:
    base = TurtleBot4(folder)
    found = check(base, base.publish_motion, seconds=1.5)
    assert not found["hazards.base"].is_well
    assert not found["hazards.kidnap"].is_well


def test_the_check_has_a_line_for_each_entry(folder: Path) -> None:
    base = TurtleBot4(folder)

    def publish() -> None:
        base.publish()
        base.publish_hazards((BUMP, "bump_front_center"))

    found = check(base, publish)
    assert found["hazards.base"].is_well
    assert "bump front center" in found["hazards.base"].text
    assert found["hazards.kidnap"].is_well
    assert "no hazard" in found["hazards.kidnap"].text
