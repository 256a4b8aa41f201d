"""What every driver for ROS must do beside other nodes: further cases of `DriverContract`."""

from __future__ import annotations

import asyncio
import itertools
import math
from collections.abc import Awaitable, Callable
from functools import partial
from typing import Any, Protocol

import pytest

from swarmd.core.messages import Reason
from swarmd.core.values import ZERO, Twist, Value
from swarmd.testing.driver_contract import (
    SETTLE_TIME,
    DetachableRig,
    DriverContract,
    DriverHarness,
    Rig,
    play,
)

FOREIGN = 0.3
"""m/s that the other node commands."""


class OtherNode(Protocol):
    """A node beside the robot's own ones."""

    @property
    def cancels(self) -> str:
        """What a report of an active goal names, so that a user can cancel it."""

    def command(self, topic: str, linear: float) -> None:
        """Command a velocity on a topic of the robot, such as `cmd_vel`."""

    def report_goal(self, *, is_active: bool) -> None:
        """Report the one goal of the action `dock`."""

    def close(self) -> None:
        """End the node, also again."""


class Dock(Protocol):
    """A node that publishes `dock`, a std_msgs/Bool, on change."""

    def put(self, is_docked: bool) -> None:
        """Publish."""

    def close(self) -> None:
        """End the node."""


class RosRig(Rig, DetachableRig, Protocol):
    """A rig of a robot on ROS."""

    def dock(self, *, is_latched: bool) -> Dock:
        """Start such a node; `is_latched`: a subscriber that comes later gets the last message."""

    def other_node(self, *, has_lidar: bool) -> OtherNode:
        """Start a node that publishes the robot's scan, or no sensor."""


DOCKED: dict[str, Value] = {
    "docked": {"topic": "dock", "type": "std_msgs/Bool", "stale_after": "never"}
}
Story = Callable[[Any, DriverHarness, OtherNode], Awaitable[None]]


def _beside(*, has_lidar: bool = False, **options: Value) -> Callable[[Story], Callable[..., None]]:
    """A test of a story with a driver that has found its base, and a node that has come since."""

    def of(story: Story) -> Callable[..., None]:
        def test(self: RosContract) -> None:
            rig = self.rig()

            async def run(harness: DriverHarness) -> None:
                other = await asyncio.to_thread(rig.other_node, has_lidar=has_lidar)
                try:
                    await story(self, harness, other)
                finally:
                    other.close()

            play(rig, run, connected=True, **options)

        test.__name__, test.__doc__ = story.__name__, story.__doc__
        return test

    return of


class RosContract(DriverContract):
    """Subclass it with a rig of ROS in place of `DriverContract`."""

    def rig(self) -> RosRig:
        raise NotImplementedError

    @_beside()
    async def test_a_stopped_robot_gets_zero_after_each_command_of_another_node(
        self, harness: DriverHarness, other: OtherNode
    ) -> None:
        """Ten commands come for each of the daemon's."""
        taken, polls = list[Twist](), itertools.count()

        def is_answered() -> bool:
            count = next(polls)
            if count % 50 == 0:
                harness.driver.send(ZERO, 1, 1, is_stopped=True)
            if count % 5 == 0:
                other.command("cmd_vel", FOREIGN)
            taken.extend(harness.rig.commands())
            pairs = [*itertools.pairwise(twist.linear for twist in taken[-60:])]
            return pairs.count((FOREIGN, 0.0)) >= 3 and (FOREIGN, FOREIGN) not in pairs

        await harness.until(is_answered, publishing=True)
        await harness.until(lambda: lost_text(harness, "someone else drives") != "")
        assert harness.sink.gets_zero
        known = len(harness.sink.odometries)
        await harness.until(lambda: len(harness.sink.odometries) > known, publishing=True)
        other.close()
        await harness.until(lambda: harness.sink.is_up, publishing=True)

    @_beside()
    async def test_a_robot_that_need_not_stand_is_left_to_the_other_node(
        self, harness: DriverHarness, other: OtherNode
    ) -> None:
        taken: list[float] = []

        def is_left() -> bool:
            other.command("cmd_vel", FOREIGN)
            harness.driver.send(Twist(0.1), 1, 1)
            taken.extend(twist.linear for twist in harness.rig.commands())
            return not harness.sink.is_up and taken[-10:] == [FOREIGN] * 10

        await harness.until(is_left, publishing=True)

    @_beside(other_commands=["cmd_vel_stamped", "cmd_vel_joy"])
    async def test_a_command_on_another_topic_of_the_base_is_another_nodes(
        self, harness: DriverHarness, other: OtherNode
    ) -> None:
        harness.driver.send(ZERO, 1, 1)
        for _ in range(10):
            other.command("cmd_vel_joy", 0.0)
            harness.rig.publish()
            await asyncio.sleep(0.05)
        assert all("someone else" not in text for _, text in harness.sink.states), "zeros"

        def is_named() -> bool:
            other.command("cmd_vel_joy", FOREIGN)
            text = lost_text(harness, "someone else drives: commands on ")
            return "/cmd_vel_joy" in text

        await harness.until(is_named, publishing=True)
        assert (await harness.command(ZERO, is_stopped=True)).is_zero
        other.command("cmd_vel_joy", FOREIGN)
        assert (await harness.command()).is_zero, "at once, without a command of the daemon"
        await harness.until(lambda: harness.sink.is_up, publishing=True)

    @_beside(other_actions=["dock"])
    async def test_an_active_goal_of_an_action_is_another_nodes_command(
        self, harness: DriverHarness, other: OtherNode
    ) -> None:
        harness.driver.send(ZERO, 1, 1)

        other.report_goal(is_active=False)

        def is_named() -> bool:
            other.report_goal(is_active=True)
            return other.cancels in lost_text(harness, "someone else drives: action ")

        await harness.until(is_named, publishing=True)
        assert (await harness.command(ZERO, is_stopped=True)).is_zero

        def is_back() -> bool:
            other.report_goal(is_active=False)
            return harness.sink.is_up

        await harness.until(is_back, publishing=True)
        await harness.until(is_named, publishing=True)
        other.close()
        await harness.until(lambda: harness.sink.is_up, publishing=True)

    @_beside(has_lidar=True)
    async def test_a_second_lidar_holds_the_robot_until_its_node_ends(
        self, harness: DriverHarness, other: OtherNode
    ) -> None:
        sink = harness.sink
        await harness.until(lambda: sink.hold is Reason.SCAN_CONFLICT, publishing=True)
        assert sink.is_up
        assert any(" publish /" in text and is_up for is_up, text in sink.states)
        other.close()
        await harness.until(lambda: sink.hold is None, publishing=True)

    @pytest.mark.parametrize("is_latched", [False, True])
    def test_a_reading_that_holds_follows_its_topic_and_ends_with_its_node(
        self, is_latched: bool
    ) -> None:
        rig = self.rig()
        dock = rig.dock(is_latched=is_latched)
        dock.put(True)

        async def story(harness: DriverHarness) -> None:
            if is_latched:
                await harness.until(lambda: docked(harness) == 1.0, publishing=True)
            await harness.until(partial(_is_put, harness, dock, True), publishing=True)
            dock.put(False)  # once: a message that is on its way at the end of its node counts
            await harness.until(lambda: docked(harness) == 0.0, publishing=True)
            dock.close()
            await harness.until(lambda: math.isnan(docked(harness)), publishing=True)
            assert harness.sink.is_up

        play(rig, story, readings=DOCKED)

    @pytest.mark.parametrize("is_latched", [False, True])
    def test_after_a_loss_the_newest_value_counts_and_no_earlier_one(
        self, is_latched: bool
    ) -> None:
        rig = self.rig()
        dock = rig.dock(is_latched=is_latched)

        async def story(harness: DriverHarness) -> None:
            await harness.until(partial(_is_put, harness, dock, True), publishing=True)
            rig.disconnect()
            await harness.until(lambda: not harness.sink.is_up)
            dock.close()
            before = len(harness.sink.taken["readings"])
            rig.reconnect()
            again = rig.dock(is_latched=is_latched)
            if is_latched:
                again.put(False)
            await harness.connect()
            await harness.until(
                lambda: docked(harness) == 0.0 if is_latched else math.isnan(docked(harness)),
                publishing=True,
            )
            assert all(
                values["docked"] != 1.0 for values in harness.sink.taken["readings"][before:]
            )
            again.close()

        play(rig, story, readings=DOCKED)


async def last_arrives(harness: DriverHarness, twist: Twist) -> list[Twist]:
    """Command until a last command has come, so that none is on its way; all that have come.

    It is `twist`, or a little faster: a driver drops a command that has waited for too long, and
    the next one must not be taken for it.
    """
    taken: list[Twist] = []
    loop, due = asyncio.get_running_loop(), -math.inf

    def has_come() -> bool:
        nonlocal due, twist
        if loop.time() >= due:
            due = loop.time() + SETTLE_TIME
            twist = Twist(twist.linear + 1e-6, twist.angular)
            harness.driver.send(twist, 1, 1)
        taken.extend(harness.rig.commands())
        return taken[-1:] == [twist]

    await harness.until(has_come, publishing=True)
    return taken


def docked(harness: DriverHarness) -> float:
    """The reading: 0 or 1, NaN while nothing is known, -1 before the driver has reported it."""
    values = harness.sink.taken["readings"]
    return values[-1].get("docked", -1.0) if values and harness.sink.is_up else -1.0


def _is_put(harness: DriverHarness, dock: Dock, value: bool) -> bool:
    dock.put(value)
    return docked(harness) == value


def lost_text(harness: DriverHarness, words: str) -> str:
    """The driver's last report of its base if it is lost and has these words; else empty."""
    is_up, text = harness.sink.states[-1]
    return "" if is_up or words not in text else text
