"""Swarms of emulated ROS 2 robots behave as those with the simulated driver."""

from __future__ import annotations

import json
import math
import os
import signal
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import pytest

from swarmd.core.messages import State
from swarmd.core.values import Array, Value
from swarmd.core.verbs import RunRequest
from swarmd.link.settings import NetworkSettings
from swarmd.operator.session.operator import Operator
from swarmd.operator.session.outcome import Outcome
from swarmd.sim.live.demo_run import WorldWatcher
from swarmd.sim.live.fleet import Fleet, FleetSpec, robot_ids
from swarmd.sim.live.link import WorldView
from swarmd.sim.live.live_scenario import LiveScenario
from swarmd.sim.live.starting import statuses_of
from swarmd.sim.live.state import WorldState
from swarmd.sim.scenarios.scenariofile import load_scenario
from swarmd.testing.driver_contract import is_running
from tests.support.processes import children, end_process, unique_swarm, wait_until, watchdogs
from tests.support.swarmctl import await_applied
from tests.support.vendor_messages import detections_folder

EXAMPLES = Path(__file__).resolve().parents[3] / "examples"
LINKED = 0.8
"""Metres between the middles of two robots of one group; the nearest are 1.1 m apart at first."""
TOLERANCE = 0.30
"""Metres by which the median distance of all pairs may differ between the two runs."""
STARTING, GATHERING = 170.0, 240.0  # s, at most


def make_spec(folder: Path, robots: tuple[str, ...], emulator: str | None) -> FleetSpec:
    return FleetSpec(
        swarm=unique_swarm(),
        robots=dict.fromkeys(robots, "burger"),
        folder=folder,
        arena="7x7",
        layout="grid:1.1",
        emulator=emulator,
    )


class Show:
    """A fleet that is up, its operator and its world."""

    def __init__(self, spec: FleetSpec, fleet: Fleet, operator: Operator, view: WorldView) -> None:
        self.spec, self.fleet, self.operator = spec, fleet, operator
        self._watch = WorldWatcher(view)

    def run(self, pattern: str, **params: Value) -> None:
        """Run it on all; asked again if a stall of the machine refused it."""
        self._pattern, self._params = pattern, params
        robots = tuple(self.spec.robots)

        def ask() -> Outcome:
            epochs = self.operator.members().epochs(robots)
            return self.operator.request(RunRequest, epochs, pattern=pattern, params=params)

        await_applied(ask, f"all run {pattern}")

    def reaches(self, holds: Callable[[WorldState], bool]) -> None:
        """Wait until it holds, with the last pattern run again on robots that a stall stopped."""

        def does_hold() -> bool:
            states = {status.state for status in statuses_of(self.operator.members()).values()}
            if State.STOPPED in states:
                self.run(self._pattern, **self._params)
            return holds(self.state())

        wait_until(does_hold, "the robots get there", GATHERING)

    def state(self) -> WorldState:
        return self._watch.wait()

    def after(self, seconds: float) -> WorldState:
        """The state so many simulated seconds later."""
        state = self.state()
        until = state.time + seconds
        while state.time < until:
            state = self._watch.wait(since=state.time)
        return state

    def is_moving(self, row: int) -> bool:
        linear, angular, _ = self.state().twists[row]
        return abs(linear) > 0.02 or abs(angular) > 0.05

    def is_up(self) -> bool:
        self.fleet.check()
        statuses = statuses_of(self.operator.members())
        return len(statuses) == len(self.spec.robots) and all(
            status.health.driver_up and status.health.scan_rate > 0.0
            for status in statuses.values()
        )


@contextmanager
def on(spec: FleetSpec) -> Iterator[Show]:
    """A fleet that is up; afterwards no process of it is left."""
    pids: set[int] = set()
    with (
        Operator(NetworkSettings(swarm=spec.swarm)) as operator,
        Fleet(spec) as fleet,
        WorldView(spec.swarm, fleet.endpoint) as view,
    ):
        show = Show(spec, fleet, operator, view)
        wait_until(show.is_up, "all are up", STARTING)
        pids |= {pid for own in fleet.pids.values() for pid in (own, *children(own))}
        pids |= {pid for robot in spec.robots for pid in watchdogs(spec.swarm, robot)}
        yield show
    wait_until(lambda: not any(map(is_running, pids)), "no process is left")


def apart(state: WorldState) -> Array:
    """(n, n) m between the middles of all robots."""
    places = np.array(state.poses)[:, :2]
    distances: Array = np.linalg.norm(places[:, None] - places[None, :], axis=-1)
    return distances


def largest_group(state: WorldState) -> int:
    """Of robots linked by `LINKED`, how many the largest group has."""
    linked = apart(state) < LINKED
    for _ in range(len(linked)):
        linked = linked @ linked
    return int(linked.sum(axis=1).max())


def median_apart(state: WorldState) -> float:
    distances = apart(state)
    return float(np.median(distances[np.triu_indices(len(distances), k=1)]))


def gather(spec: FleetSpec, settling: float) -> tuple[float, float]:
    """Gather all robots, wait `settling` s; the median distance of all pairs before and after."""
    n = len(spec.robots)
    with on(spec) as show:
        begin = show.state()
        assert largest_group(begin) == 1
        show.run("attraction")
        show.reaches(lambda state: largest_group(state) == n)
        end = show.after(settling)
        assert largest_group(end) == n
        assert end.contacts == end.arena_contacts == 0
        for robot in spec.robots:
            assert len(watchdogs(spec.swarm, robot)) == (0 if spec.emulator is None else 1)
    return median_apart(begin), median_apart(end)


@pytest.mark.integration
def test_two_daemons_gather_over_ros2dds(tmp_path: Path) -> None:
    before, after = gather(make_spec(tmp_path, robot_ids("burger", 2), "ros2dds"), settling=1.0)
    assert after < 0.8 * before


@pytest.mark.integration
@pytest.mark.evidence
@pytest.mark.timeout(1200)
def test_seven_daemons_gather_over_ros2dds_as_simulated(tmp_path: Path) -> None:
    ended = {}
    for emulator in ("ros2dds", None):
        folder = tmp_path / (emulator or "simulated")
        spec = make_spec(folder, robot_ids("burger", 7), emulator)
        before, ended[emulator] = gather(spec, settling=10.0)
        print(
            f"{emulator or 'simulated'}: pairs {before:.2f} m apart, then {ended[emulator]:.2f} m"
        )
        assert ended[emulator] < 0.7 * before
    assert abs(ended["ros2dds"] - ended[None]) <= TOLERANCE


@pytest.mark.integration
@pytest.mark.timeout(600)
@pytest.mark.parametrize(
    "emulator", ["rmw_zenoh", pytest.param("ros2dds", marks=pytest.mark.evidence)]
)
def test_the_watchdog_stops_a_base_without_command_timeout(emulator: str, tmp_path: Path) -> None:
    spec = make_spec(tmp_path, ("tb3-01",), emulator)
    with on(spec) as show:
        show.run("random_walk")
        show.reaches(lambda _: show.is_moving(0))
        assert show.state().commanded == (True,)
        os.kill(show.fleet.pids["tb3-01"], signal.SIGKILL)
        wait_until(lambda: not show.is_moving(0), "it stands")
        after = show.after(2.0)
        assert after.commanded == (True,)  # its watchdog sends zero again and again
        assert not show.is_moving(0)
        for pid in watchdogs(spec.swarm, "tb3-01"):
            end_process(pid)


@pytest.mark.integration
@pytest.mark.timeout(600)
def test_turtlebot4_runs_its_patterns_over_ros2dds_with_stamped_commands(tmp_path: Path) -> None:
    """As Jazzy has it: commands are TwistStamped; the floor is read at four places of the robot.

    Its camera's tags arrive as an AprilTagDetectionArray, with which it drives to the box.
    """
    tags = {
        "topic": "detections",
        "type": "apriltag_msgs/AprilTagDetectionArray",
        "at": [-0.06, 0.0],
        "image_width": 1280,
        "field_of_view_deg": 63,
        "size": 0.1,
        "kinds": {"7": "box"},
    }
    camera = {"message_path": str(detections_folder(tmp_path)), "detections": {"tags": tags}}
    driver = json.dumps({"cmd_vel_type": "twist_stamped", **camera})
    file = tmp_path / "tiles.yaml"
    file.write_text(
        "description: a TurtleBot on tiles\n"
        "duration: 60\n"
        "arena: {size: [5, 5], boxes: [{name: crate, at: [1, 0.5], size: [0.3, 0.3], mass: 5}]}\n"
        "fields:\n"
        "  - kind: floor\n"
        "    name: ground\n"
        "    patches: [{rectangle: [0, 0, 5, 5], tiles: 0.3, share: 0.6, colour: 0, seed: 1}]\n"
        "platforms:\n"
        f"  tb4: {{extends: turtlebot4, drivers: {{ros2dds: {driver}}}}}\n"
        "groups: {all: {platform: tb4, count: 1, prefix: tb4, pattern: random_walk}}\n"
        "start: {layout: list, poses: [[-1, 0, 2]]}\n"
    )
    scenario = load_scenario(file)
    spec = FleetSpec(
        swarm=unique_swarm(),
        robots={robot: platform.name for robot, platform in scenario.robots.items()},
        folder=tmp_path / "logs",
        emulator="ros2dds",
        live=LiveScenario(scenario),
        plugin_dir=EXAMPLES,
    )
    with on(spec) as show:
        show.run("approach_tag", kind="box")
        show.reaches(lambda state: math.dist(state.poses[0][:2], (1.0, 0.5)) < 0.9)
        for pattern in ("policy", "random_walk", "attraction", "collective_perception"):
            show.run(pattern)
            show.reaches(lambda _: show.is_moving(0))

        def read() -> list[Mapping[str, Value]]:
            return [one.readings for one in statuses_of(show.operator.members()).values()]

        wait_until(lambda: all("ground_4" in one for one in read()), "floors are read")
        assert all(one["ground_4"] in (0.0, 1.0) for one in read())
        end = show.state()
        assert end.contacts == end.arena_contacts == 0
