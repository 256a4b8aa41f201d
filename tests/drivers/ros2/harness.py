"""A driver played against a robot that the test controls."""

from __future__ import annotations

import asyncio
import time
from collections.abc import Callable, Mapping

from swarmd.core.finding import Finding
from swarmd.core.values import ZERO, Twist, Value
from swarmd.testing.driver_contract import TIMEOUT, DriverHarness
from tests.drivers.ros.contract import last_arrives
from tests.drivers.ros2.robots import Robot

PACE = 0.01
STALL = 0.8
"""s; a reading is stale after 1 s."""


def stands(twist: Twist) -> bool:
    """Whether this is the zero for either type: read as a Twist it is 5e-324 m/s to the side."""
    return max(abs(twist.linear), abs(twist.angular), abs(twist.lateral)) < 1e-300


async def drive(harness: DriverHarness) -> None:
    """Command until the base moves, with zero first, and no command is still on its way."""
    harness.driver.send(Twist(0.1), 1, 1)
    assert stands((await last_arrives(harness, Twist(0.2)))[0])


async def freeze(harness: DriverHarness, stop: Callable[[], None]) -> None:
    """Freeze the hub while it passes nothing on."""
    while not (await harness.command(ZERO)).is_zero:
        pass  # a command that left before
    await asyncio.sleep(0.05)  # the last message of the hub is no fresh sign of life
    stop()


async def drive_on(harness: DriverHarness, thaw: Callable[[], None]) -> list[Twist]:
    """Command at 20 Hz until the base is lost, thaw the hub, and return all that the base gets."""
    taken: list[Twist] = []

    def has_come() -> bool:
        taken.extend(harness.rig.commands())  # several at once, as after a stall
        return bool(taken)

    for _ in range(20):
        harness.driver.send(Twist(0.1), 1, 1)
        await asyncio.sleep(0.05)
    await harness.until(lambda: not harness.sink.is_up, publishing=True)
    harness.rig.commands()
    thaw()
    await harness.until(has_come)
    await asyncio.sleep(1.0)
    return [*taken, *harness.rig.commands()]


def check(
    robot: Robot,
    publish: Callable[[], None] = lambda: None,
    *,
    seconds: float = 3.0,
    tries: int = 1,
    **options: Value,
) -> Mapping[str, Finding]:
    """The findings of `check`, by subject, while `publish` is called repeatedly.

    `tries`: so many checks for one in which all is well; a busy machine publishes too rarely. A
    check that finds old messages, since a stall let this process publish nothing for STALL s, is
    done again.
    """

    async def once() -> tuple[Finding, ...]:
        is_stalled = True
        async with asyncio.timeout(TIMEOUT):
            while is_stalled:
                checking = asyncio.create_task(robot.make(options).check(seconds))
                is_stalled, last = False, time.monotonic()
                while not checking.done():
                    publish()
                    await asyncio.sleep(PACE)
                    is_stalled |= time.monotonic() - last > STALL
                    last = time.monotonic()
                is_stalled &= any("stale after" in one.text for one in checking.result())
        return checking.result()

    async def run() -> tuple[Finding, ...]:
        for _ in range(tries):
            findings = await once()
            if all(finding.is_well for finding in findings):
                break
        return findings

    try:
        return {finding.subject: finding for finding in asyncio.run(run())}
    finally:
        robot.close()


def reported(harness: DriverHarness, part: str, *, is_up: bool | None = None) -> bool:
    """Whether the driver has reported this text about its base."""
    return any(part in text and is_up in (None, up) for up, text in harness.sink.states)
