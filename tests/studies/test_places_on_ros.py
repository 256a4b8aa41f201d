"""Patterns that need places of neighbours, on four TurtleBots behind the real bridge, in real time.

Each robot has a daemon, and a node on DDS with the topics of lidar, base and tracker. The same
scenario runs in lockstep with boards, and with boards on robots that never move. `make evidence`
with `ARGS="-s -k turtlebots"` prints the figures of the patterns' pages.
"""

from __future__ import annotations

import contextlib
import math
import threading
import time
from collections import Counter
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, cast

import pytest
from cyclonedds.domain import Domain

from swarmd.core.codec import Decoder
from swarmd.core.events import OdometryInput, ScanInput, SensorInput
from swarmd.core.messages import State, Status
from swarmd.core.values import Twist, Value
from swarmd.core.verbs import RunRequest
from swarmd.drivers.ros import cdr
from swarmd.drivers.ros.options import RosOptions
from swarmd.drivers.ros.to_ros import LaserScanEncoder, odometry_message
from swarmd.link.settings import NetworkSettings
from swarmd.operator.session.operator import Operator
from swarmd.sim.live.link import Command, EmulatorTransport, WorldLink, WorldView
from swarmd.sim.live.live_scenario import LiveScenario
from swarmd.sim.live.realtime import RealTimeWorld
from swarmd.sim.live.recording import LiveRecorder, StatusLog
from swarmd.sim.live.state import WorldOptions
from swarmd.sim.scenarios.scenario import Scenario
from swarmd.sim.scenarios.scenariofile import load_scenario
from swarmd.sim.scenarios.simulation import meta_of, world_of
from swarmd.sim.trace import load_trace
from swarmd.sim.world.seeding import generator
from swarmd.sim.world.world import World
from tests.studies.test_places import BOARD, ENOUGH, FIGURES, SHARED_SET, STILL, reached, run, show
from tests.support import ros2_types as dds
from tests.support.dds_node import DdsNode
from tests.support.processes import DaemonProcess, unique_swarm, wait_until
from tests.support.ros2_bridge import LOOPBACK, Bridge, free_domain, why_no_bridge

SEEDS = {"chain_formation": 10}
"""Runs of each source; five of the patterns that are not named."""
TRACKED = "tracker"
FOUR: Mapping[str, Mapping[str, Any]] = {
    "chain_formation": {
        "duration": 150.0,
        "groups.tb3.count": 2,
        "radio.range": 1.65,
        "start.poses": [[0, 0, 0], [1.75, 0, 0], [-0.8, -0.4, 0], [-0.8, 0.4, 0]],
    },
    "hexagonal_lattice": {"duration": 40.0, "groups.tb3.count": 4, "start.size": [1.2, 1.2]},
    "leader_following": {
        "duration": 60.0,
        "groups.tb3.count": 4,
        "start.poses": [[-0.6 * k, -1.4, 0] for k in range(4)],
        "events": [],
    },
    "lloyd_coverage": {"duration": 40.0, "groups.tb3.count": 4},
    "shepherding": {
        "duration": 120.0,
        "groups.tb3.count": 2,
        "start.poses": [[-1.5, 0, 0], [2.2, 0.1, 0], [0.9, -0.4, 0], [0.9, 0.4, 0]],
    },
    "vicsek_alignment": {"duration": 30.0, "groups.tb3.count": 4, "start.size": [1.4, 1.4]},
}
"""What the scenario of each pattern has for four robots, and for how many s it runs.

One member joins nest and goal, which do not sense each other.
"""
GOALS = {
    "chain_formation": ("nest-01", "leads", 1.0),
    "shepherding": ("shepherd-01", "state", "arrived"),
}
"""Robot, name and value of a report with which a run has its figure and ends."""
RATE, SD, SD_DEG = 10.0, 0.02, 2.0
"""Poses a second of the tracker, and the standard deviations of its errors in m and degrees."""
GAP, GAP_PERIOD = 0.5, 5.0
"""s without a pose, once in each period, at a random phase by robot."""
BLIND = 10.0, 15.0
"""s of the run between which one robot has no pose."""
_OPTIONS: Mapping[str, Value] = {
    "shared_pose": "tracker",
    "shared_pose_error": 3.0 * SD,
    "shared_pose_error_deg": 3.0 * SD_DEG,
}
_TOPICS = {"scan": dds.LaserScan, "odom": dds.Odometry, "tracker": dds.PoseStamped}
_status = Decoder(Status)


class TurtleBots:
    """The robots' nodes on DDS, as the world's transport; called by the thread of the world."""

    dropped = 0

    def __init__(self, world: World, recorder: LiveRecorder, domain: int, seed: int) -> None:
        self.side = self
        self._world, self._recorder = world, recorder
        self._rng = generator(seed, "poses", "tracker")
        self._phases = self._rng.uniform(0.0, GAP_PERIOD, len(world.ids))
        self._blind, self._due = seed % len(world.ids), world.time
        self._encoders = {
            robot: LaserScanEncoder(RosOptions(), platform)
            for robot, platform in zip(world.ids, world.platforms, strict=True)
        }
        self.nodes = {robot: self._node(domain, f"/{_space(robot)}") for robot in world.ids}

    def send(self, robot: str, input: SensorInput) -> None:
        """Publish a scan or odometry."""
        if isinstance(input, ScanInput):
            (message,) = self._encoders[robot].encode(input.scan)
            self._publish(robot, "scan", cdr.encode(message))
        elif isinstance(input, OdometryInput):
            self._publish(robot, "odom", cdr.encode(odometry_message(input.odometry)))

    def take_commands(self) -> Mapping[str, Command]:
        """The newest command of each robot; the tracker measures in between."""
        if self._world.time >= self._due:
            self._due += 1.0 / RATE
            self._track()
        now, taken = time.monotonic(), {}
        for robot, node in self.nodes.items():
            for one in node.take(f"/{_space(robot)}/cmd_vel"):
                taken[robot] = Command(Twist(one.linear.x, one.angular.z, one.linear.y), now)
        return taken

    def close(self) -> None:
        for node in self.nodes.values():
            node.close()

    def _track(self) -> None:
        """Publish the pose of each robot that is in no gap."""
        noise = self._rng.normal(0.0, (SD, SD, math.radians(SD_DEG)), (len(self._world.ids), 3))
        is_blind = BLIND[0] <= self._recorder.seconds < BLIND[1]
        for row, (x, y, yaw) in enumerate((self._world.poses() + noise).tolist()):
            is_gap = (self._world.time + self._phases[row]) % GAP_PERIOD < GAP
            if is_gap or (is_blind and row == self._blind):
                continue
            turned = dds.Quaternion(z=math.sin(0.5 * yaw), w=math.cos(0.5 * yaw))
            pose = dds.Pose(dds.Vector3(x, y), turned)
            message = dds.PoseStamped(dds.stamped(time.monotonic(), "world"), pose)
            robot = self._world.ids[row]
            self.nodes[robot].publish(f"/{_space(robot)}/tracker", message)

    def _publish(self, robot: str, topic: str, payload: bytes) -> None:
        message = _TOPICS[topic].deserialize(payload)
        self.nodes[robot].publish(f"/{_space(robot)}/{topic}", message)

    @staticmethod
    def _node(domain: int, space: str) -> DdsNode:
        published = {f"{space}/{topic}": kind for topic, kind in _TOPICS.items()}
        commands = {f"{space}/cmd_vel": dds.Twist}
        return DdsNode(domain, "turtlebot3_node", published, commands, namespace=space)


def _space(robot: str) -> str:
    return robot.replace("-", "_")


@dataclass(frozen=True, slots=True)
class Run:
    """A run in real time."""

    figure: float
    contacts: int
    slowed: float  # s of real time in the run for each s of the world
    holds: Mapping[str, float]  # share of the robots' time by reason


class Rig:
    """The nodes and daemons of four robots, the bridge between them, and their world."""

    def __init__(self, folder: Path, name: str, seed: int) -> None:
        folder.mkdir(exist_ok=True)
        changes = {**FIGURES[name].changes, **FOUR[name], **SHARED_SET}
        self.name, self._seed, self._folder = name, seed, folder
        self._scenario: Scenario = load_scenario(name, changes)
        self.swarm = unique_swarm()
        self._log = StatusLog()
        self._statuses: dict[str, Status] = {}
        self._goal_at = math.inf  # s of the recording
        self._has_begun = False

    def play(self) -> Run:
        """Run the pattern on all robots for the duration of the scenario."""
        scenario, seconds = self._scenario, self._scenario.duration
        world = world_of(scenario, self._seed, sectors=100)
        trace = self._folder / "run.npz"
        options = WorldOptions(
            swarm=self.swarm, trace=str(trace), trace_rate=scenario.trace_rate, seconds=seconds
        )
        self._recorder = LiveRecorder(world, options, meta_of(scenario, self._seed))
        recorder, robots = self._recorder, scenario.robots
        with contextlib.ExitStack() as left:
            domain = free_domain()
            left.callback(lambda held: None, Domain(domain, LOOPBACK))
            bridge = left.enter_context(Bridge(self._folder, domain))
            bots = TurtleBots(world, recorder, domain, self._seed)
            left.callback(bots.close)
            link = WorldLink(self.swarm, robots, "tcp/127.0.0.1:0")
            left.callback(link.close)
            live = RealTimeWorld(
                world,
                link,
                recorder,
                emulated=cast("EmulatorTransport", bots),
                command_timeouts=[math.inf] * len(robots),
                seed=self._seed,
            )
            left.enter_context(_running(live))
            daemons = [left.enter_context(self._daemon(robot, bridge)) for robot in robots]
            for daemon in daemons:
                daemon.wait_ready()
            network = NetworkSettings(swarm=self.swarm)
            operator = left.enter_context(Operator(network, name="study@bench"))
            operator.watch("status", self._on_status)
            view = left.enter_context(WorldView(self.swarm, link.viewers))
            with contextlib.suppress(AssertionError):
                wait_until(lambda: self._start(operator), "all run")
            assert self._is_started(), self._describe()
            view.ask("start")
            begun, self._has_begun = time.monotonic(), True
            self._log.add(0.0, self._statuses)
            wait_until(self._is_over, "the end of the run", 3.0 * seconds)
            view.ask("finish")
            slowed = (time.monotonic() - begun) / recorder.seconds
        merged = self._log.merged_into(load_trace(trace))
        assert merged.reason is not None
        counts = Counter(merged.reason.ravel().tolist())
        holds = {reason: n / merged.reason.size for reason, n in counts.items()}
        return Run(FIGURES[self.name].of(merged), recorder.contacts, slowed, holds)

    def _daemon(self, robot: str, bridge: Bridge) -> DaemonProcess:
        """The daemon of a Burger as shipped, with what the scenario sets, bridge and tracker."""
        options: dict[str, Any] = dict(
            LiveScenario(self._scenario).daemon_config(robot, self._folder)
        )
        options["platform"] = "burger"  # the scenario's has places without a driver
        options["driver"] = "ros2dds"
        options["driver_options"] = {
            "endpoint": bridge.endpoint,
            "namespace": "{robot}",
            **_OPTIONS,
        }
        radio = self._scenario.radio
        if radio.neighborhood != "all":
            options["neighbors"] = {"neighborhood": radio.neighborhood, "range": radio.range}
        return DaemonProcess(
            self._folder, swarm=self.swarm, robot=robot, endpoint="", options=options
        )

    def _is_over(self) -> bool:
        """Whether the recording has ended, or holds 1 s after the goal of the pattern."""
        robot, name, value = GOALS.get(self.name, ("", "", None))
        status, seconds = self._statuses.get(robot), self._recorder.seconds
        if status is not None and status.report.get(name) == value:
            self._goal_at = min(self._goal_at, seconds)
        return seconds > self._goal_at + 1.0 or not self._recorder.is_running

    def _start(self, operator: Operator) -> bool:
        """Whether all robots run; requests a run of each that does not, once all drivers are up."""
        members = operator.members(timeout=1.0).members
        idle = {}
        for robot, member in members.items():
            if member.status is None or not member.status.health.driver_up:
                return False
            self._statuses[robot] = member.status
            if member.status.state is not State.RUNNING:
                idle[robot] = member.epoch
        if len(members) < len(self._scenario.robots):
            return False
        for event in self._scenario.events:
            asked = {robot: idle[robot] for robot in event.robots if robot in idle}
            if event.action == "run" and asked:
                operator.request(
                    RunRequest, asked, pattern=event.pattern, params=event.parameters, timeout=3.0
                )
        return not idle

    def _is_started(self) -> bool:
        return len(self._statuses) == len(self._scenario.robots) and all(
            one.state is State.RUNNING for one in self._statuses.values()
        )

    def _describe(self) -> str:
        return "; ".join(
            f"{robot}: {one.state} {one.reason} {one.detail} {one.health.driver}"
            for robot, one in self._statuses.items()
        )

    def _on_status(self, robot: str, payload: bytes) -> None:
        self._statuses[robot] = status = _status(payload)
        if self._has_begun:
            self._log.add(self._recorder.seconds, {robot: status})


@contextlib.contextmanager
def _running(live: RealTimeWorld) -> Iterator[None]:
    over = threading.Event()
    thread = threading.Thread(target=live.run, args=(over.is_set,))
    thread.start()
    try:
        yield
    finally:
        over.set()
        thread.join()


@pytest.mark.evidence
@pytest.mark.integration
@pytest.mark.skipif(bool(why_no_bridge()), reason=why_no_bridge())
@pytest.mark.parametrize("name", FOUR)
def test_four_turtlebots_reach_what_boards_reach_or_the_page_tells(
    name: str, tmp_path: Path
) -> None:
    seeds = range(SEEDS.get(name, 5))
    figures = {
        source: [run((name, source, seed), FOUR[name]) for seed in seeds]
        for source in (BOARD, STILL)
    }
    figures[TRACKED] = []
    for seed in seeds:
        done = Rig(tmp_path / str(seed), name, seed).play()
        print(f"{name}: {TRACKED}, seed {seed}: {done}")
        figures[TRACKED].append(done.figure)
    show(name, figures)
    page = (Path(__file__).parents[2] / f"patterns/{name}/page.md").read_text()
    is_enough = reached(name, figures[BOARD], figures[TRACKED]) >= ENOUGH
    assert is_enough or "less than 80 %" in page.partition("Four emulated TurtleBots")[2]
    assert reached(name, figures[BOARD], figures[STILL]) < ENOUGH
