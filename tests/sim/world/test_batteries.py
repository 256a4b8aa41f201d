"""The charge of simulated batteries, and a low battery in lockstep and live."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from swarmd.core.errors import ConfigError
from swarmd.core.messages import Reason, State, Status
from swarmd.core.verbs import RunRequest
from swarmd.link.settings import NetworkSettings
from swarmd.operator.session.operator import Operator
from swarmd.operator.session.outcome import Outcome
from swarmd.sim.live.fleet import Fleet, FleetSpec
from swarmd.sim.live.live_scenario import LiveScenario
from swarmd.sim.live.starting import await_robots
from swarmd.sim.lockstep.lockstep import Lockstep, simulate_run
from swarmd.sim.scenarios.scenario import Scenario
from swarmd.sim.scenarios.scenariofile import scenario_of
from swarmd.sim.world.batteries import charge
from tests.support.processes import unique_swarm, wait_until
from tests.support.swarmctl import await_applied, heard_statuses

TURNS = {"below": 0.5, "pattern": "drive", "params": {"speed": 0.0, "turn": 0.5}, "seconds": 5.0}


def made(battery: dict[str, float], given: dict[str, Any] | None, **group: Any) -> Scenario:
    return scenario_of(
        {
            "duration": 20.0,
            "arena": {"size": [8.0, 8.0]},
            "platforms": {"burger": {"body": battery}},
            "groups": {"tb3": {"platform": "burger", "count": 1, **group}},
            "start": {"layout": "list", "poses": [[0.0, 0.0, 0.0]]},
            "on_low_battery": given,
        }
    )


@pytest.mark.parametrize(
    ("body", "now", "left"),
    [
        ({}, 0.0, None),
        ({"battery_time": 10.0}, 2.0, 0.8),
        ({"battery_time": 10.0, "battery_start": 0.5}, 2.0, 0.3),
        ({"battery_time": 10.0}, 20.0, 0.0),
    ],
)
def test_the_charge_falls_evenly_to_zero(
    body: dict[str, float], now: float, left: float | None
) -> None:
    platform = made(body, None).robots["tb3-01"]
    assert charge(platform, now).get("battery") == (None if left is None else pytest.approx(left))


@pytest.mark.parametrize("given", [None, {"below": 0.5}, TURNS])
def test_a_low_battery_in_lockstep(given: dict[str, Any] | None) -> None:
    scenario = made({"battery_time": 10.0}, given, pattern="drive", parameters={"speed": 0.1})
    trace = simulate_run(scenario, seed=1)
    x, yaw = trace.pose[:, 0, 0], trace.pose[:, 0, 2]
    when = np.linspace(0.0, 20.0, len(x))
    is_over = when > 11.0  # 5 s until it is low, 5 s until it counts
    drives_on = bool(np.ptp(x[is_over]) > 0.5)
    assert drives_on is (given is None)
    turned = float(np.ptp(yaw[is_over]))
    assert (turned > 1.5) is (given is TURNS)
    assert np.ptp(yaw[when > 17.0]) < 0.02  # the pattern of the low battery has ended
    assert np.array_equal(x, simulate_run(scenario_of(scenario.effective), seed=1).pose[:, 0, 0])


def test_the_reason_is_told_in_lockstep() -> None:
    run = Lockstep(made({"battery_time": 10.0}, {"below": 0.5}, pattern="drive"), seed=1)
    run.advance(12.0)
    shell = run.shells[0]
    assert shell is not None
    assert (shell.robot.state, shell.robot.reason) == (State.STOPPED, Reason.LOW_BATTERY)


@pytest.mark.parametrize(
    ("given", "text"),
    [
        ({"below": 0.2, "pattern": "driv"}, "on_low_battery.pattern: no pattern 'driv'"),
        ({**TURNS, "params": {"sped": 1.0}}, "on_low_battery.params.sped"),
        ({"below": 0.2, "recovered": 0.1}, "on_low_battery.recovered is 0.1"),
    ],
)
def test_a_faulty_section_is_refused_in_one_line(given: dict[str, Any], text: str) -> None:
    with pytest.raises(ConfigError) as caught:
        made({}, given)
    assert text in str(caught.value)
    assert "\n" not in str(caught.value)


@pytest.mark.integration
def test_a_live_robot_knows_that_its_battery_is_low(tmp_path: Path) -> None:
    scenario = made({"battery_time": 1e4, "battery_start": 0.3}, TURNS)
    spec = FleetSpec(
        swarm=unique_swarm(),
        robots={"tb3-01": "burger"},
        folder=tmp_path,
        live=LiveScenario(scenario),
    )
    with Fleet(spec) as fleet, Operator(NetworkSettings(swarm=spec.swarm)) as operator:

        def status() -> Status:
            return heard_statuses(operator, ["tb3-01"])["tb3-01"]

        def is_low() -> bool:
            battery = status().battery
            return battery is not None and battery.is_low

        def run() -> Outcome:
            return operator.request(RunRequest, {"tb3-01": status().epoch}, pattern="random_walk")

        await_robots(operator, fleet)
        wait_until(is_low, "the battery is low", 60.0)
        assert any("below 0.5 (0.30)" in event.text for event in status().events)
        await_applied(run, "an operator runs the Burger")
        assert status().pattern == "random_walk"
