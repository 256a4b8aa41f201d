"""Robots whose requests have another version, beside one of this version."""

from __future__ import annotations

import contextlib
from pathlib import Path

import pytest

from swarmd.core import codec
from tests.support.processes import DaemonProcess, free_endpoint, wait_until
from tests.swarm.conftest import Swarm

pytestmark = pytest.mark.integration

OFFSETS = {"r2": 1, "r3": -1}


def test_robots_of_other_versions_are_stopped_and_shown_and_refuse_the_rest_by_name(
    swarm: Swarm, tmp_path: Path
) -> None:
    """r2 is newer, r3 older."""
    swarm.spawn("r1", swarm.resting("r1"))
    endpoints = {robot: free_endpoint() for robot in OFFSETS}
    with contextlib.ExitStack() as left:
        others = {
            robot: left.enter_context(
                DaemonProcess(
                    tmp_path / robot,
                    swarm=swarm.name,
                    robot=robot,
                    endpoint=endpoints[robot],
                    module=(
                        "tests.support.other_version",
                        str(offset),
                        swarm.name,
                        robot,
                        endpoints[robot],
                    ),
                )
            )
            for robot, offset in OFFSETS.items()
        }
        for other in others.values():
            other.wait_ready()
        swarm.status("r1")
        speaks = {
            robot: f"speaks {codec.VERSION + offset}, this swarmctl {codec.VERSION}"
            for robot, offset in OFFSETS.items()
        }
        shown = swarm.ctl("members")
        assert shown.code == 0
        rows = [line.split() for line in shown.out.splitlines()]
        for robot, text in speaks.items():
            assert f"{robot} {text}" in shown.out
            (row,) = (row for row in rows if row[:1] == [robot])
            assert row[:3] == [robot, "idle", "never_asked"]
        assert "# other version: " in shown.out

        ran = swarm.ctl("run", "drive", "--all")
        assert ran.outcome == (3, "3 targeted, 1 applied, 2 refused (r2, r3)")
        assert all(f"{robot} {text}" in ran.out for robot, text in speaks.items())
        for robot, other in others.items():
            done = swarm.ctl("run", "drive", robot)
            assert done.outcome == (7, f"1 targeted, 0 applied, 1 refused ({robot})")
            wait_until(  # the answer comes before the line
                lambda other=other: other.text().count("refused (other_version)") == 2,  # type: ignore[misc]
                "two refusals",
            )

        assert swarm.ctl("stop").outcome == (0, "3 targeted, 3 applied")
        assert swarm.ctl("estop", "r2").outcome == (0, "1 targeted, 1 applied")
        assert swarm.ctl("estop").outcome == (0, "3 targeted, 3 applied")
        listed = swarm.ctl("members", "-o", "json").json["members"]
        assert {one["robot"]: one["state"] for one in listed} == {
            "r1": "estopped",
            "r2": "estopped",
            "r3": "estopped",
        }
        assert all(text in swarm.ctl("describe", robot).out for robot, text in speaks.items())
