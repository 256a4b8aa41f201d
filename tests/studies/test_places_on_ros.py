"""Patterns that need places of neighbours, on four TurtleBots behind the real bridge, in real time.

Each robot has a daemon and a node on DDS, with a lidar, a base, and a tracker in place of a board.
The same scenario runs with boards in place of tracker and bridge, with daemons, too, and in
lockstep with robots that never move. `make evidence` with `ARGS="-s -k turtlebots"` prints the
figures of the patterns' pages.
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
from swarmd.core.verbs import ResetRequest, RunRequest
from swarmd.drivers.ros import cdr
from swarmd.drivers.ros.options import RosOptions
from swarmd.drivers.ros.to_ros import LaserScanEncoder, odometry_message
from swarmd.network.operator.operator import Operator
from swarmd.network.settings import NetworkSettings
from swarmd.sim.live.link import Command, EmulatorTransport, WorldLink, WorldView
from swarmd.sim.live.live_scenario import LiveScenario
from swarmd.sim.live.realtime import RealTimeWorld
from swarmd.sim.live.recording import LiveRecorder, StatusLog
from swarmd.sim.live.state import WorldOptions
from swarmd.sim.scenarios.scenario import Scenario
from swarmd.sim.scenarios.scenariofile import load_scenario
from swarmd.sim.scenarios.simulation import meta_of, radio_of, world_of
from swarmd.sim.trace import load_trace
from swarmd.sim.world.seeding import generator
from swarmd.sim.world.world import World
from tests.studies.test_places import BOARD, ENOUGH, FIGURES, STILL, reached, run, show
from tests.support import ros2_types as dds
from tests.support.dds_node import DdsNode
from tests.support.processes import DaemonProcess, unique_swarm, wait_until
from tests.support.ros2_bridge import LOOPBACK, Bridge, free_domain, why_no_bridge

SEEDS = 5
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
    """The daemons of four robots, and their world in a thread."""

    def __init__(self, folder: Path, name: str, source: str, seed: int) -> None:
        self.name, self._source, self._seed, self._folder = name, source, seed, folder
        radio = {"radio.range_and_bearing": source == BOARD}
        tracked = {} if source == BOARD else {"radio.places": "shared"}
        changes = {**FIGURES[name].changes, **FOUR[name], **radio, **tracked}
        folder.mkdir(exist_ok=True)
        self._scenario: Scenario = load_scenario(name, changes)
        self.swarm = unique_swarm()
        self._log = StatusLog()
        self._statuses: dict[str, Status] = {}
        self._begun = math.inf
        self._bots: TurtleBots | None = None

    def play(self) -> Run:
        """Run the pattern on all robots for the duration of the scenario."""
        scenario, trace = self._scenario, self._folder / "run.npz"
        is_board = self._source == BOARD
        world = world_of(scenario, self._seed, sectors=10 if is_board else 100)
        options = WorldOptions(
            swarm=self.swarm,
            trace=str(trace),
            trace_rate=scenario.trace_rate,
            seconds=scenario.duration,
        )
        recorder = LiveRecorder(world, options, meta_of(scenario, self._seed))
        with contextlib.ExitStack() as left:
            link = WorldLink(self.swarm, scenario.robots, "tcp/127.0.0.1:0")
            left.callback(link.close)
            given = self._boards(link) if is_board else self._bridged(world, recorder, left)
            live = RealTimeWorld(
                world,
                link,
                recorder,
                radio=radio_of(scenario, self._seed) if is_board else None,
                emulated=cast("EmulatorTransport", self._bots) if self._bots else None,
                command_timeouts=None if is_board else [math.inf] * len(scenario.robots),
                seed=self._seed,
            )
            left.enter_context(_running(live))
            LiveScenario(scenario).write(self._folder)
            daemons = [left.enter_context(self._daemon(robot, given)) for robot in world.ids]
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
            self._begun = time.monotonic()
            self._log.add(0.0, self._statuses)
            robot, name, value = GOALS.get(self.name, ("", "", None))
            goal_at: list[float] = []

            def is_over() -> bool:
                """Whether the recording has ended, or holds 1 s after the goal."""
                status = self._statuses.get(robot)
                if status is not None and status.report.get(name) == value:
                    goal_at.append(recorder.seconds)
                has_goal = bool(goal_at) and recorder.seconds > goal_at[0] + 1.0
                return has_goal or not recorder.is_running

            wait_until(is_over, "the end of the run", 3.0 * scenario.duration)
            view.ask("finish")
            slowed = (time.monotonic() - self._begun) / recorder.seconds
        merged = self._log.merged_into(load_trace(trace))
        assert merged.reason is not None
        counts = Counter(merged.reason.ravel().tolist())
        holds = {reason: n / merged.reason.size for reason, n in counts.items()}
        return Run(FIGURES[self.name].of(merged), recorder.contacts, slowed, holds)

    def _boards(self, link: WorldLink) -> dict[str, Any]:
        """What the daemons of robots with boards are configured with."""
        return {"driver": "simulated", "driver_options": {"endpoint": link.endpoint, "radio": True}}

    def _bridged(
        self, world: World, recorder: LiveRecorder, left: contextlib.ExitStack
    ) -> dict[str, Any]:
        """Start the bridge and the nodes; what the daemons are configured with."""
        domain = free_domain()
        left.callback(lambda held: None, Domain(domain, LOOPBACK))
        bridge = left.enter_context(Bridge(self._folder, domain))
        self._bots = TurtleBots(world, recorder, domain, self._seed)
        left.callback(self._bots.close)
        options = {"endpoint": bridge.endpoint, "namespace": "{robot}", **_OPTIONS}
        return {"driver": "ros2dds", "driver_options": options}

    def _daemon(self, robot: str, given: Mapping[str, Any]) -> DaemonProcess:
        own: dict[str, Any] = dict(LiveScenario(self._scenario).daemon_config(robot, self._folder))
        if self._source == TRACKED:
            own["platform"] = "burger"  # as shipped: the scenario's has places without a driver
            radio = self._scenario.radio
            if radio.neighborhood != "all":
                own["neighbors"] = {"neighborhood": radio.neighborhood, "range": radio.range}
        return DaemonProcess(
            self._folder, swarm=self.swarm, robot=robot, endpoint="", options={**own, **given}
        )

    def _start(self, operator: Operator) -> bool:
        """Whether all robots run; asks those that do not, together if none does."""
        members = operator.members(timeout=1.0).members
        idle = {}
        for robot, member in members.items():
            if member.status is None or not member.status.health.driver_up:
                return False
            self._statuses[robot] = member.status
            if member.status.latches:
                latches = tuple(member.status.latches)
                operator.request(ResetRequest, {robot: member.epoch}, ids=latches, timeout=1.0)
                return False
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
        if self._begun < math.inf:
            self._log.add(time.monotonic() - self._begun, {robot: status})


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
def test_four_turtlebots_with_a_tracker_reach_what_boards_reach(name: str, tmp_path: Path) -> None:
    figures: dict[str, list[float]] = {BOARD: [], TRACKED: []}
    for source, values in figures.items():
        for seed in range(SEEDS):
            done = Rig(tmp_path / f"{source}-{seed}", name, source, seed).play()
            print(f"{name}: {source}, seed {seed}: {done}")
            values.append(done.figure)
    figures[STILL] = [run((name, STILL, seed), FOUR[name]) for seed in range(SEEDS)]
    show(name, figures)
    assert reached(name, figures[BOARD], figures[TRACKED]) >= ENOUGH
    assert reached(name, figures[BOARD], figures[STILL]) < ENOUGH
