"""A real daemon whose robot is approached faster than its platform declares, again and again."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import pytest
from msgspec.structs import replace

from swarmd.core.clock import boottime
from swarmd.core.messages import State
from tests.support.processes import wait_until

if TYPE_CHECKING:
    from swarmd.core.values import Scan
    from tests.swarm.conftest import Swarm

pytestmark = pytest.mark.integration

RATE = 20.0  # scans a second: five of one approach must arrive within 0.85 s


def test_a_robot_that_is_rammed_twice_goes_on(swarm: Swarm, tmp_path: Path) -> None:
    """A front comes from 1.4 to 0.2 m at 0.6 m/s every six seconds; declared are 0.4 m/s."""
    body = swarm.body("r1", RATE)

    def ramming(seq: int, stamp: float) -> Scan:
        scan, distance = body.clear(seq, stamp), max(1.4 - 0.6 * (stamp % 6.0), 0.2)
        ahead = np.abs(scan.bearings) < 0.5
        return replace(scan, ranges=np.where(ahead, distance, scan.ranges))

    def is_over() -> bool:
        if daemon.process.poll() is not None:
            return True
        statuses = swarm.statuses("r1")
        if any(status.state is not State.RUNNING for status in statuses):  # a stall ends a run
            swarm.ctl("run", "drive", "r1", "-p", "speed=0")
        return any(status.findings for status in statuses)

    body.scans = ramming
    platform = tmp_path / "fast_lidar.yaml"
    platform.write_text(f"extends: waffle_pi\nscan: {{rate: {RATE}}}")
    daemon = swarm.start("r1", body, {"platform": str(platform)})
    wait_until(is_over, "rammed twice")
    assert daemon.process.poll() is None, daemon.text()
    assert "things came at" in swarm.status("r1").findings[0]
    body.wait(lambda command: True, boottime())
