"""A live Jackal beside a Burger that it cannot see: both know their poses in one frame."""

from __future__ import annotations

from pathlib import Path

import pytest

from swarmd.core.messages import Reason, State, Status
from swarmd.core.verbs import RunRequest
from swarmd.link.settings import NetworkSettings
from swarmd.operator.session.operator import Operator
from swarmd.operator.session.outcome import Outcome
from swarmd.sim.live.fleet import Fleet, FleetSpec
from swarmd.sim.live.live_scenario import LiveScenario
from swarmd.sim.live.starting import await_robots
from swarmd.sim.scenarios.scenariofile import scenario_of
from tests.support.processes import unique_swarm, wait_until
from tests.support.swarmctl import await_applied, heard_statuses

JACKAL, BURGER = "jackal-01", "tb3-01"


@pytest.mark.integration
def test_a_jackal_drives_beside_a_burger_that_tells_its_place(tmp_path: Path) -> None:
    spec = FleetSpec(
        swarm=unique_swarm(),
        robots={JACKAL: "jackal", BURGER: "burger"},
        folder=tmp_path,
        arena="8x8",
        layout="grid:3",
        lidar_visibility="real",
        shared_frame=True,
    )
    with Fleet(spec) as fleet, Operator(NetworkSettings(swarm=spec.swarm)) as operator:

        def status() -> Status:
            return heard_statuses(operator, [JACKAL])[JACKAL]

        def finds() -> list[tuple[str, str, bool]]:
            return [(found.robot, found.kind, found.holds) for found in status().peers]

        await_robots(operator, fleet)
        wait_until(lambda: finds() == [(BURGER, "unseen", False)], "the Burger is told")

        def run() -> Outcome:
            return operator.request(RunRequest, {JACKAL: status().epoch}, pattern="random_walk")

        await_applied(run, "the Jackal runs")
        wait_until(lambda: abs(status().decision.safe_linear) > 0.05, "the Jackal drives")
        assert status().state is State.RUNNING
        assert status().reason is not Reason.INCOMPATIBLE_PEER
        assert status().peers[0].text.endswith("told")


@pytest.mark.integration
def test_a_live_robot_knows_its_place_in_its_fence(tmp_path: Path) -> None:
    scenario = scenario_of(
        {
            "arena": {"size": [8.0, 8.0]},
            "groups": {"tb3": {"platform": "burger", "count": 1}},
            "start": {"layout": "list", "poses": [[0.0, 0.0, 0.0]]},
            "fence": {"frame": "world", "polygon": [[-1, -1], [1, -1], [1, 1], [-1, 1]]},
        }
    )
    spec = FleetSpec(
        swarm=unique_swarm(),
        robots={BURGER: "burger"},
        folder=tmp_path,
        live=LiveScenario(scenario),
    )
    with Fleet(spec) as fleet, Operator(NetworkSettings(swarm=spec.swarm)) as operator:

        def status() -> Status:
            return heard_statuses(operator, [BURGER])[BURGER]

        def clearance() -> float | None:
            fence = status().fence
            return None if fence is None else fence.clearance

        await_robots(operator, fleet)
        wait_until(lambda: clearance() is not None, "the pose is used")
        found = clearance()
        assert found is not None
        assert 0.8 < found < 1.0

        def run() -> Outcome:
            return operator.request(
                RunRequest, {BURGER: status().epoch}, pattern="drive", params={"speed": 0.2}
            )

        def is_near() -> bool:
            if status().state is State.STOPPED:  # a stall has ended its run
                await_applied(run, "the Burger runs")
            return (clearance() or 1.0) < 0.3

        await_applied(run, "the Burger runs")
        wait_until(is_near, "the Burger has come near its fence")
        for _ in range(20):
            now = clearance()
            assert now is None or now > 0.0
