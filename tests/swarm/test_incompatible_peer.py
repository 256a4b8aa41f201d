"""A robot that hears of a peer that it does not see is held, and runs if that is granted."""

from __future__ import annotations

from typing import TYPE_CHECKING

import pytest

from swarmd.core.messages import Presence, Reason, State
from swarmd.settings.platforms import load_platform
from tests.support.fake_body import Body
from tests.support.processes import attempts

if TYPE_CHECKING:
    from swarmd.core.values import Value
    from tests.swarm.conftest import Swarm

pytestmark = pytest.mark.integration


def test_a_jackal_beside_a_burger_is_held_until_it_is_forgotten_or_granted(swarm: Swarm) -> None:
    platform = load_platform("jackal")
    with Body(platform, swarm=swarm.name, robot="jackal-01") as body:
        jackal = swarm.start("jackal-01", body, {"platform": "jackal"})
        slow: dict[str, Value] = {"platform": "burger", "accepts_faster": ["jackal"]}
        burger = swarm.start("tb3-01", None, slow)
        swarm.await_status("jackal-01", "aware of its peer", lambda status: bool(status.peers))

        for _ in attempts("the run ends by the peer and by no stall"):
            swarm.run_drive("jackal-01")
            held = swarm.await_state("jackal-01", State.STOPPED)
            if held.reason not in (Reason.STALE_SCAN, Reason.LOOP_STALLED):
                break
        assert held.reason is Reason.INCOMPATIBLE_PEER
        assert [(f.robot, f.kind, f.holds) for f in held.peers] == [("tb3-01", "unseen", True)]
        assert any("tb3-01" in event.text and "not seen" in event.text for event in held.events)
        assert not any(command.twist.linear for command in body.commands)
        swarm.await_status("tb3-01", "aware of its peer", lambda status: bool(status.peers))
        lines = swarm.ctl("members").out.splitlines()
        assert [line for line in lines if "jackal-01 held by tb3-01" in line]
        assert [line for line in lines if "tb3-01 beside jackal-01" in line and "accepted" in line]

        assert burger.terminate() == 0  # it left, and stands there still
        swarm.await_presence("jackal-01", "tb3-01", Presence.LEFT)
        assert swarm.status("jackal-01").peers
        assert swarm.ctl("members", "forget", "tb3-01").code == 0
        swarm.await_status("jackal-01", "free of its peer", lambda status: not status.peers)

        assert jackal.terminate() == 0
        granted: dict[str, Value] = {"platform": "jackal", "accepts_unseen": {"burger": "a fence"}}
        swarm.start("jackal-01", body, granted)
        swarm.start("tb3-01", None, slow)
        seen = swarm.await_status("jackal-01", "aware of its peer", lambda s: bool(s.peers))
        assert "a fence" in seen.peers[0].text
        swarm.run_drive("jackal-01")
        body.wait_moving()
