"""What the drivers for ROS send while two bases or two sources of scans conflict, without ROS."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import pytest

from swarmd.core.messages import Reason
from swarmd.core.values import ZERO, Twist
from swarmd.drivers.ros.diagnosis import Conflict
from swarmd.plugins import load_driver
from swarmd.settings.platforms import load_platform

BURGER = load_platform("burger")


@pytest.mark.parametrize("reason", ["two_bases", "two_scan_sources"])
@pytest.mark.parametrize("name", ["ros1", "ros2dds", "rmw_zenoh"])
async def test_a_robot_with_a_conflict_gets_zero_alone(
    name: str, reason: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The row `two_bases` of what fails (docs/safety.md): it stops."""
    driver: Any = load_driver(name)(swarm="s", robot="r", platform=BURGER, options={})
    sent: list[Twist] = []
    monkeypatch.setattr(driver, "_put", lambda twist, *_: sent.append(twist))
    # ROS 1 has no credit of a hub, and does not look at it.
    driver._credit = SimpleNamespace(offer=lambda twist, _: twist, asks=lambda _: False)
    driver._gate.open()
    driver.send(ZERO, 1, 1)
    driver.send(Twist(0.1), 2, 2)
    driver._conflict = Conflict(Reason(reason), "in the way")
    driver.send(Twist(0.1, 0.2), 3, 3)
    driver._conflict = None
    driver.send(Twist(0.2), 4, 4)
    assert sent == [ZERO, Twist(0.1), ZERO, Twist(0.2)]


@pytest.mark.parametrize("reason", ["", "two_bases"])
def test_a_command_that_waits_for_its_hub_does_not_leave_in_a_conflict(
    reason: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    driver: Any = load_driver("ros2dds")(swarm="s", robot="r", platform=BURGER, options={})
    sent: list[Twist] = []
    monkeypatch.setattr(driver, "_put", lambda twist, *_: sent.append(twist))
    driver._credit = SimpleNamespace(release=lambda _: Twist(0.3))
    driver._gate.open()
    driver._gate.filter(ZERO)
    driver._conflict = Conflict(Reason(reason), "in the way") if reason else None
    driver._release(1.0)
    assert sent == ([] if reason else [Twist(0.3)])
