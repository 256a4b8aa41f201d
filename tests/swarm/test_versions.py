"""Robots whose requests have another version, beside one of this version."""

from __future__ import annotations

from pathlib import Path

import pytest

from swarmd.core import codec
from tests.support.processes import DaemonProcess
from tests.swarm.conftest import Swarm

pytestmark = pytest.mark.integration


@pytest.mark.parametrize("offset", [1, -1], ids=["newer", "older"])
def test_a_robot_of_another_version_is_stopped_and_shown_and_refuses_the_rest_by_name(
    swarm: Swarm, tmp_path: Path, offset: int
) -> None:
    swarm.spawn("r1")
    with DaemonProcess(
        tmp_path / "other",
        swarm=swarm.name,
        robot="r2",
        endpoint="tcp/127.0.0.1:9",
        module=("tests.support.other_version", str(offset)),
    ) as other:
        other.wait_ready()
        swarm.status("r1")
        speaks = f"r2 speaks {codec.VERSION + offset}, this swarmctl {codec.VERSION}"

        shown = swarm.ctl("members")
        assert shown.code == 0
        assert f"# other version: {speaks}" in shown.out.splitlines()
        (row,) = (line.split() for line in shown.out.splitlines() if line.startswith("r2 "))
        assert row[:3] == ["r2", "idle", "never_asked"]

        ran = swarm.ctl("run", "drive", "--all")
        assert ran.outcome == (3, "2 targeted, 1 applied, 1 refused (r2)")
        assert speaks in ran.out
        assert swarm.ctl("run", "drive", "r2").outcome == (
            7,
            "1 targeted, 0 applied, 1 refused (r2)",
        )
        assert other.text().count("refused (other_version)") == 2

        assert swarm.ctl("stop").outcome == (0, "2 targeted, 2 applied")
        assert swarm.ctl("estop", "r2").outcome == (0, "1 targeted, 1 applied")
        assert swarm.ctl("estop").outcome == (0, "2 targeted, 2 applied")
        states = {
            one["robot"]: one["state"] for one in swarm.ctl("members", "-o", "json").json["members"]
        }
        assert states == {"r1": "estopped", "r2": "estopped"}
        assert speaks.removeprefix("r2 ") in swarm.ctl("describe", "r2").out
