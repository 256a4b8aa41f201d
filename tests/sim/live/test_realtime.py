"""The real-time world with a manual clock, and what it takes from and gives to its link."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any, cast

import numpy as np
import pytest
from msgspec.structs import astuple

from swarmd.core.codec import encode
from swarmd.core.errors import SwarmError
from swarmd.core.events import OdometryInput, ScanInput, SensorInput, tag_of
from swarmd.core.values import Odometry, Platform, Scan, Twist, Value
from swarmd.driver_api.emulator import EmulatorFactory, OnCommand
from swarmd.driver_api.hw_codec import MessageWire
from swarmd.settings.platforms import load_platform
from swarmd.sim.live.link import Command, EmulatorTransport, PendingRequest, WorldLink, WorldView
from swarmd.sim.live.realtime import COMMAND_TIMEOUT, RealTimeWorld
from swarmd.sim.live.recording import LiveRecorder
from swarmd.sim.live.state import Action, WorldOptions, WorldReply, WorldRequest, WorldState
from swarmd.sim.trace import load_trace
from swarmd.sim.world.arena import Arena, Box
from swarmd.sim.world.item_kind import ItemKind
from swarmd.sim.world.radio import Radio, RadioSettings
from swarmd.sim.world.realism import IDEAL, Actuation, LidarNoise, Realism
from swarmd.sim.world.scalar_fields import Field, UniformField
from swarmd.sim.world.world import World
from tests.support.processes import wait_until

IDS = ("a", "b")
FOR_EVER = (math.inf, math.inf)
CRATE = Box(0.0, 0.0, 0.2, 0.2, name="crate", mass=5.0, is_placed=False)


class HandLink:
    """A link whose commands, messages and requests a test gives, and which lists what is sent."""

    dropped = 0

    def __init__(self) -> None:
        self.commands: dict[str, Command] = {}
        self.grips: dict[str, bool] = {}
        self.said: list[MessageWire] = []
        self.requests: list[PendingRequest] = []
        self.sent: list[tuple[str, str, Any]] = []

    def take_commands(self) -> Mapping[str, Command]:
        commands, self.commands = self.commands, {}
        return commands

    def take_grips(self) -> Mapping[str, bool]:
        grips, self.grips = self.grips, {}
        return grips

    def take_messages(self) -> list[MessageWire]:
        messages, self.said = self.said, []
        return messages

    def take_requests(self) -> list[PendingRequest]:
        requests, self.requests = self.requests, []
        return requests

    def send(self, robot: str, input: SensorInput) -> None:
        (value,) = astuple(input)
        self.sent.append((robot, tag_of(input), value))

    def messages(self, robot: str, messages: Sequence[MessageWire]) -> None:
        self.sent.append((robot, "received", list(messages)))

    def publish_state(self, state: WorldState) -> None:
        """States are looked at by `RealTimeWorld._state`."""


class Side:
    """A fake emulator that records what it publishes and sends given commands."""

    def __init__(
        self, *, robots: Mapping[str, Platform], endpoint: str, on_command: OnCommand
    ) -> None:
        self.driver_options: Mapping[str, Value] = {"endpoint": endpoint}
        self.dropped = 3
        self.command = on_command
        self.scans: list[tuple[str, Scan]] = []
        self.poses: list[tuple[str, Odometry]] = []

    def publish(self, robot: str, input: SensorInput) -> None:
        if isinstance(input, ScanInput):
            self.scans.append((robot, input.scan))
        elif isinstance(input, OdometryInput):
            self.poses.append((robot, input.odometry))

    def close(self) -> None:
        """Nothing is open."""


class ManualWorld:
    """Two Burgers, 2 m beside each other, in real time with a manual clock."""

    def __init__(
        self,
        options: WorldOptions | None = None,
        realism: Realism = IDEAL,
        radio: RadioSettings | None = None,
        fields: tuple[Field, ...] = (),
        boxes: tuple[Box, ...] = (),
        items: tuple[ItemKind, ...] = (),
        emulator: EmulatorFactory | None = None,
        command_timeouts: Sequence[float] | None = None,
        link: WorldLink | None = None,
    ) -> None:
        self.now = 100.0
        starts = np.array([[0.0, 0.0, 0.0], [0.0, 2.0, 0.0]])
        robots = dict.fromkeys(IDS, load_platform("burger"))
        arena = Arena(6.0, 6.0, boxes, items=tuple(item for kind in items for item in kind.things))
        self.world = World(robots, arena, starts, realism=realism, fields=fields, items=items)
        self.link = HandLink()
        self.recorder = LiveRecorder(self.world, options or WorldOptions(swarm="s"), {"seed": 7})
        emulated = None
        if emulator is not None:
            emulated = EmulatorTransport(emulator, robots, "here", clock=lambda: self.now)
        self.server = RealTimeWorld(
            self.world,
            link or cast(WorldLink, self.link),
            self.recorder,
            radio=None if radio is None else Radio(radio, IDS, arena, seed=0),
            emulated=emulated,
            command_timeouts=command_timeouts,
            clock=lambda: self.now,
        )

    def pass_time(self, seconds: float) -> None:
        for _ in range(round(seconds / self.world.dt)):
            self.now += self.world.dt
            self.server.run_due()

    def command(self, robot: str, speed: float, seq: int | None = None) -> None:
        self.link.commands[robot] = Command(Twist(speed), self.now, seq)

    def speed(self, robot: int = 0) -> float:
        return float(self.world.twists()[robot, 0])

    def speeds(self) -> list[float]:
        return [self.speed(row) for row in (0, 1)]

    def sent(self, name: str, robot: str = "a") -> list[Any]:
        """What was sent of one kind to a robot, in order."""
        return [value for one, kind, value in self.link.sent if (one, kind) == (robot, name)]


def test_a_command_moves_its_robot_until_half_a_second_after_the_last() -> None:
    live = ManualWorld()
    live.command("a", 0.2, 1)
    live.pass_time(COMMAND_TIMEOUT - 0.02)
    assert live.speeds() == pytest.approx([0.2, 0.0])
    live.pass_time(0.02 + 0.1)  # and the ramp down
    assert live.speed() == 0.0
    live.pass_time(2.0)
    assert live.speed() == 0.0
    live.command("a", -0.1, live.world._seq[0])
    live.pass_time(0.3)
    assert live.speed() == pytest.approx(-0.1)


def test_a_gripper_carries_an_item_which_the_state_shows_and_the_robot_reads() -> None:
    food = ItemKind(name="food", at=[(0.06, 0.0)], source=(2.0, 2.0, 0.5))
    live = ManualWorld(items=(food,), command_timeouts=FOR_EVER)
    live.link.grips["a"] = True
    live.command("a", 0.2)
    live.pass_time(1.0)
    assert live.sent("readings")[-1]["held"] == 1.0
    assert live.sent("readings", "b")[-1]["held"] == 0.0
    boxes = live.server._state().boxes
    assert boxes["food-1"][0] == pytest.approx(float(live.world.poses()[0, 0]) + 0.038)


@pytest.mark.parametrize(("scans_ago", "moves"), [(5, False), (3, True)])
def test_late_commands_of_a_frozen_daemon_do_not_move_its_base(scans_ago: int, moves: bool) -> None:
    live = ManualWorld()
    live.pass_time(3.0)
    live.command("a", 0.2, live.world._seq[0] - scans_ago)
    live.pass_time(0.3)
    assert (live.speed() > 0.0) is moves


def test_scans_and_odometry_come_at_their_rates_and_not_all_at_once() -> None:
    live = ManualWorld()
    live.pass_time(5.0)
    for robot in IDS:
        assert len(live.sent("scan", robot)) == pytest.approx(25, abs=1)
        assert len(live.sent("odometry", robot)) == pytest.approx(100, abs=1)
    a, b = ({scan.stamp for scan in live.sent("scan", robot)} for robot in IDS)
    assert not a & b


def test_neighbors_are_the_robots_with_daemons_within_reach_told_at_once() -> None:
    radio = RadioSettings(neighborhood="range", range=2.5)
    near = ManualWorld(radio=radio, command_timeouts=FOR_EVER)
    far = ManualWorld(
        radio=RadioSettings(neighborhood="range", range=1.5), command_timeouts=FOR_EVER
    )
    for live in (near, far):
        live.pass_time(1.1)
        assert {one for robot in IDS for one in live.sent("neighbors", robot)} == {()}
        live.command("a", 0.0)
        live.command("b", 0.0)
        live.pass_time(0.01)
    told = [[(one.id, one.distance) for one in near.sent("neighbors", robot)[-1]] for robot in IDS]
    assert told == [[("b", None)], [("a", None)]]
    assert far.sent("neighbors")[-1] == ()


def test_range_and_bearing_is_measured_from_the_true_poses() -> None:
    live = ManualWorld(radio=RadioSettings(range_and_bearing=True), command_timeouts=FOR_EVER)
    live.command("b", 0.0)
    live.pass_time(0.2)
    (neighbor,) = live.sent("neighbors")[-1]
    assert neighbor.distance == pytest.approx(2.0, abs=0.3)  # five standard deviations
    assert neighbor.bearing == pytest.approx(math.pi / 2.0, abs=0.2)


def test_a_message_reaches_the_others_after_the_delay_of_the_radio() -> None:
    live = ManualWorld(radio=RadioSettings(delay=0.3))
    said = MessageWire("b", "vote/opinion", b"x")
    live.link.said = [said]
    live.pass_time(0.28)
    assert live.sent("received") == []
    live.pass_time(0.05)
    assert live.sent("received") == [[said]]
    assert live.sent("received", "b") == []


def test_a_robot_receives_its_scalar_readings() -> None:
    live = ManualWorld(fields=(UniformField(name="light", value=0.5),))
    live.pass_time(1.0)
    assert live.sent("readings")[-1] == {"light": 0.5}


def test_a_delayed_scan_has_not_arrived() -> None:
    live = ManualWorld(realism=Realism(lidar=LidarNoise(latency=1.0), actuation=Actuation()))
    while not live.sent("scan"):
        assert live.server._sent_seq[0] == -1
        live.pass_time(0.01)
    assert live.world.time - live.sent("scan")[0].stamp == pytest.approx(0.2)


def test_lost_time_is_given_up_after_a_freeze() -> None:
    live = ManualWorld()
    live.command("a", 0.2)
    live.pass_time(0.2)
    before = live.world.time
    live.now += 60.0
    live.server.run_due()
    assert live.world.time == pytest.approx(before + live.world.dt)
    live.pass_time(0.2)
    assert live.speed() == 0.0


def test_records_from_start_to_finish_only(tmp_path: Path) -> None:
    path = tmp_path / "run.npz"
    live = ManualWorld(WorldOptions(swarm="s", trace=str(path)))
    live.pass_time(1.0)
    live.recorder.begin()
    live.command("a", 0.2)
    live.pass_time(0.5)
    assert live.recorder.finish() == path
    live.pass_time(1.0)
    live.recorder.finish()
    trace = load_trace(path)
    assert trace.ids == IDS
    assert trace.t[0] == pytest.approx(0.01, abs=0.01)
    assert trace.t[-1] == pytest.approx(0.5, abs=0.02)
    assert trace.safe[5, 0].tolist() == [0.2, 0.0, 0.0]
    assert trace.meta == {"seed": 7, "seconds": pytest.approx(0.5)}


def test_recording_ends_by_itself_when_its_time_is_full(tmp_path: Path) -> None:
    live = ManualWorld(WorldOptions(swarm="s", trace=str(tmp_path / "run.npz"), seconds=0.3))
    live.pass_time(1.0)
    state = live.server._state()
    assert not state.is_recording
    assert state.recorded == pytest.approx(0.3)
    assert load_trace(tmp_path / "run.npz").duration == pytest.approx(0.28, abs=0.03)


def test_touches_are_counted_and_recorded(tmp_path: Path) -> None:
    live = ManualWorld(
        WorldOptions(swarm="s", trace=str(tmp_path / "run.npz")), command_timeouts=FOR_EVER
    )
    live.command("a", 0.22)
    live.pass_time(16.0)
    state = live.server._state()
    live.recorder.finish()
    assert (state.contacts, state.arena_contacts) == (0, 1)
    trace = load_trace(tmp_path / "run.npz")
    assert set(map(tuple, trace.contact_pair.tolist())) == {(0, -1)}
    assert trace.contact_speed[0, 0] == pytest.approx(0.22)


def test_a_box_is_put_in_the_way_and_taken_out_of_it_over_zenoh(tmp_path: Path) -> None:
    link = WorldLink("s", IDS, "tcp/127.0.0.1:0")
    live = ManualWorld(
        WorldOptions(swarm="s", trace=str(tmp_path / "run.npz")), boxes=(CRATE,), link=link
    )

    def asked(deed: Callable[[WorldView], WorldState]) -> WorldState:
        """The reply to a viewer's request."""
        with ThreadPoolExecutor(1) as pool, WorldView("s", link.viewers) as view:
            answer = pool.submit(deed, view)

            def is_answered() -> bool:
                live.pass_time(0.01)
                return answer.done()

            wait_until(is_answered, "answered")
            return answer.result()

    try:
        state = asked(lambda view: view.place("crate", (1.0, 0.0, 0.0)))
        there = live.world.box_poses()[0].tolist()
        live.pass_time(0.5)  # some of which is recorded
        asked(lambda view: view.remove("crate"))
        with pytest.raises(SwarmError, match=r"'create'.*'crate'"):
            asked(lambda view: view.place("create", (0.0, 0.0, 0.0)))
    finally:
        link.close()
    live.recorder.finish()
    assert state.ids == IDS
    assert there == [1.0, 0.0, 0.0]
    assert np.isnan(live.world.box_poses()).all()
    poses = load_trace(tmp_path / "run.npz").box_pose
    assert poses is not None
    assert np.unique(poses[~np.isnan(poses[:, 0, 0]), 0], axis=0).tolist() == [[1.0, 0.0, 0.0]]


def test_a_request_changes_the_fields_of_a_name() -> None:
    live, replies = ManualWorld(), list[WorldReply]()
    live.world.fields = (UniformField(name="light", value=1.0),)
    brighter = UniformField(name="light", value=3.0)
    payload = encode(WorldRequest(action="fields", fields=(brighter,)))
    live.link.requests = [PendingRequest(payload, replies.append)]
    live.pass_time(0.01)
    assert replies[0].is_done
    assert live.world.readings(0) == {"light": 3.0}


@pytest.mark.parametrize(
    ("payload", "fault", "dropped"),
    [
        (encode(WorldRequest(action="place", box="crate")), "overlap a", 0),
        (encode(WorldRequest(action="take_out", robot="c")), "'c'", 0),
        (b"rubbish", "", 1),
        (encode(WorldRequest(action="fault", fault={"scan": "frosen"})), "'frozen'", 0),
        (encode(WorldRequest(action="fault", fault={"scan": "lost"}, robots=("c",))), "'c'", 0),
        (encode(WorldRequest(action="fault", fault={"radio": "mute"}, robots=("a",))), "radio", 0),
        (encode(WorldRequest(action="fault", fault={"process": "killed"})), "daemons", 0),
        (encode(WorldRequest(action="fault", fault={"battery": "low"}, robots=("a",))), "a has", 0),
    ],
)
def test_a_request_that_cannot_be_done_is_answered_with_the_reason(
    payload: bytes, fault: str, dropped: int
) -> None:
    live, replies = ManualWorld(boxes=(CRATE,)), list[WorldReply]()
    live.link.requests = [PendingRequest(payload, replies.append)]
    live.pass_time(0.01)
    (reply,) = replies
    assert not reply.is_done
    assert fault in reply.text
    assert live.server._state().dropped == dropped


def test_a_fault_begins_and_ends_by_request() -> None:
    live, replies = ManualWorld(), list[WorldReply]()

    def ask(action: Action) -> WorldState:
        request = WorldRequest(action=action, fault={"scan": "lost", "share": 1.0}, robots=("b",))
        live.link.requests = [PendingRequest(encode(request), replies.append)]
        live.pass_time(0.01)
        assert replies[-1].is_done, replies[-1].text
        return replies[-1].state

    def scanning(seconds: float) -> set[str]:
        live.link.sent.clear()
        live.pass_time(seconds)
        return {robot for robot, tag, _ in live.link.sent if tag == "scan"}

    assert ask("fault").faults == {"b": "scan lost"}
    live.pass_time(0.5)  # a scan on its way
    assert scanning(1.0) == {"a"}
    assert ask("mend").faults == {}
    assert scanning(1.0) == {"a", "b"}


@pytest.fixture
def emulated() -> tuple[ManualWorld, Side]:
    """Emulated bases that stop after 0.5 s without a command, or never."""
    sides: list[Side] = []

    def make(**values: Any) -> Side:
        sides.append(Side(**values))
        return sides[0]

    return ManualWorld(emulator=make, command_timeouts=(0.5, math.inf)), sides[0]


def test_an_emulated_base_stops_by_its_own_timeout_or_never(
    emulated: tuple[ManualWorld, Side],
) -> None:
    live, side = emulated
    live.pass_time(0.2)
    assert live.server._state().commanded == (False, False)
    for robot in IDS:
        for speed in (0.1, 0.05, 0.2):  # the newest counts
            side.command(robot, Twist(speed))
    live.pass_time(0.45)
    assert live.speeds() == pytest.approx([0.2, 0.2])
    live.pass_time(1.0)
    assert live.speeds() == pytest.approx([0.0, 0.2], abs=1e-6)
    state = live.server._state()
    assert (state.commanded, state.dropped) == ((False, True), 3)
    side.command("b", Twist())
    live.pass_time(0.5)
    assert live.speeds() == pytest.approx([0.0, 0.0], abs=1e-6)


def test_every_emulated_robot_publishes_its_sensors(emulated: tuple[ManualWorld, Side]) -> None:
    live, side = emulated
    live.pass_time(2.0)
    for robot in IDS:
        assert len([r for r, _ in side.scans if r == robot]) in (9, 10)
        assert len([r for r, _ in side.poses if r == robot]) in (39, 40)
    assert all(len(scan.ranges) == 360 for _, scan in side.scans)
