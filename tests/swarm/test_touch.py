"""A real daemon with a pattern that pushes, in front of a post: granted, and not."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import pytest
from msgspec.structs import replace

from swarmd.core.clock import boottime

if TYPE_CHECKING:
    from swarmd.core.values import Scan, Value
    from tests.support.fake_body import Body, ScanScript
    from tests.swarm.conftest import Swarm

pytestmark = pytest.mark.integration

EXAMPLES = Path(__file__).resolve().parents[2] / "examples"


def post_ahead(body: Body) -> ScanScript:
    """Scans that show a post 6 cm before the front of a Waffle Pi, and else walls far away."""

    def scan(seq: int, stamp: float) -> Scan:
        scan = body.clear(seq, stamp)
        return replace(scan, ranges=np.where(np.abs(scan.bearings) < 0.2, 0.21, scan.ranges))

    return scan


def start(swarm: Swarm, tmp_path: Path, touch: Value) -> Body:
    platform = tmp_path / "barred.yaml"
    platform.write_text("extends: waffle_pi\nprotection: {mode: barrier}")
    body = swarm.body("r1")
    body.scans = post_ahead(body)
    options: dict[str, Value] = {"platform": str(platform), "plugin_dir": str(EXAMPLES)}
    swarm.start("r1", body, {**options, "touch": touch})
    return body


def test_a_granted_push_presses_at_the_granted_speed(swarm: Swarm, tmp_path: Path) -> None:
    body = start(swarm, tmp_path, {"push": {"half_width_deg": 20, "speed": 0.08}})
    assert swarm.ctl("run", "push", "r1").code == 0
    pressing = body.wait_stepped()
    assert pressing.twist.linear == pytest.approx(0.08)
    described = swarm.ctl("describe", "r1").out
    assert "push may touch: +-20 deg ahead at up to 0.08 m/s" in described
    asked = boottime()
    assert swarm.ctl("run", "drive", "r1", "-p", "recovery=false").code == 0
    body.wait(
        lambda command: (
            command.twist.is_zero and command.requested_scan_seq > pressing.requested_scan_seq
        ),
        asked,
    )
    assert max(command.twist.linear for command in body.commands) <= 0.08 + 1e-9


def test_a_push_without_grant_is_held_and_names_the_grant(swarm: Swarm, tmp_path: Path) -> None:
    body = start(swarm, tmp_path, {})
    assert swarm.ctl("run", "push", "r1").code == 0
    status = swarm.await_status("r1", "asked to step", lambda status: status.decision.decisions > 9)
    assert status.decision.requested_linear == pytest.approx(0.1)
    assert all(command.twist.linear <= 0.0 for command in body.commands)
    described = swarm.ctl("describe", "r1").out
    assert "push asks to touch +-20 deg ahead at up to 0.10 m/s, which is not granted" in described
    assert "`touch: {push: ...}` in the robot's configuration grants it" in described
