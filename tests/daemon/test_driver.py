"""The driver of a daemon: which commands it is handed."""

from __future__ import annotations

from typing import Any, cast

import pytest
from msgspec.structs import replace

from swarmd.core.values import ZERO, Twist
from swarmd.daemon.driver import DriverOutput
from swarmd.driver_api.driver import Driver
from swarmd.robot.actions import Actions
from swarmd.robot.protection.decision import Decision
from swarmd.settings.driver_options import BaseOptions, may_rest
from tests.support.robot_harness import RobotHarness

STOPPED = Actions(ZERO, cast("Decision", None), is_stopped=True)


class Taken:
    """A driver that keeps what it is handed."""

    def __init__(self, is_simulated: bool = False) -> None:
        self.is_simulated = is_simulated
        self.commands: list[tuple[Twist, bool]] = []

    def send(self, twist: Twist, *seqs: int, is_stopped: bool = False) -> None:
        self.commands.append((twist, is_stopped))


def handed(*actions: tuple[Actions, bool], is_simulated: bool = False) -> list[tuple[Twist, bool]]:
    """The commands that the driver is handed for actions, each of which may repeat one or not."""
    driver = Taken(is_simulated)
    output = DriverOutput(cast("Driver", driver), "taken", "zeros", lambda error: None)
    for one, may_repeat in actions:
        output.command(_decided(one), 0.0, may_repeat=may_repeat)
    return driver.commands


def _decided(actions: Actions) -> Actions:
    return replace(actions, decision=RobotHarness("burger").robot.decision)


def test_a_scan_repeats_no_zero_of_a_robot_that_stands() -> None:
    assert handed((STOPPED, True), (STOPPED, False), (STOPPED, False)) == [(ZERO, True)]
    idle = replace(STOPPED, is_idle=True, is_stopped=False)
    assert handed((idle, True), (idle, False), (idle, True)) == [(ZERO, False)] * 2


def test_a_scan_that_changes_the_command_of_a_robot_that_stands_sends_it() -> None:
    moving = Actions(Twist(0.1), cast("Decision", None))
    found = handed((moving, True), (STOPPED, False), (STOPPED, False))
    assert found == [(Twist(0.1), False), (ZERO, True)]
    idle = replace(STOPPED, is_idle=True, is_stopped=False)
    assert handed((idle, False), (STOPPED, False)) == [(ZERO, False), (ZERO, True)]


@pytest.mark.parametrize("is_simulated", [False, True])
def test_a_scan_sends_a_changed_command_at_once_and_the_tick_repeats_it(is_simulated: bool) -> None:
    for twist in (ZERO, Twist(0.1)):
        running = Actions(twist, cast("Decision", None))
        turning = Actions(Twist(0.1, 0.2), cast("Decision", None))
        scans = [(running, False), (running, False), (turning, False), (turning, False)]
        found = handed((running, True), *scans, (turning, True), is_simulated=is_simulated)
        assert found == [(twist, False), (Twist(0.1, 0.2), False), (Twist(0.1, 0.2), False)]


@pytest.mark.parametrize(("is_simulated", "count"), [(False, 1), (True, 3)])
def test_a_simulator_gets_an_equal_command_for_each_scan(is_simulated: bool, count: int) -> None:
    driver = Taken(is_simulated)
    output = DriverOutput(cast("Driver", driver), "taken", "zeros", lambda error: None)
    decided = _decided(Actions(Twist(0.1), cast("Decision", None)))
    # The scan of the decision and that of the request; a pair may repeat.
    for scan, requested_scan in ((1, 1), (2, 1), (2, 1), (2, 2), (2, 2)):
        decision = replace(decided.decision, scan_seq=scan)
        actions = replace(decided, decision=decision, requested_scan_seq=requested_scan)
        output.command(actions, 0.0, may_repeat=False)
    assert len(driver.commands) == count


@pytest.mark.parametrize(
    ("command_timeout", "is_simulated", "may"),
    [
        (None, True, True),
        (None, False, True),  # the watchdog
        ("base", False, True),
        (0.4, False, True),
        (0.39, False, False),
        (0.1, True, False),
    ],
)
def test_a_base_that_bears_short_silence_alone_gets_twenty_zeros_a_second(
    command_timeout: Any, is_simulated: bool, may: bool
) -> None:
    base = BaseOptions(command_timeout=command_timeout)
    assert may_rest(base, cast("Driver", Taken(is_simulated))) is may
