"""The real-time world with a manual clock, over real Zenoh on loopback."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from swarmd.core.errors import SwarmError
from swarmd.core.values import Odometry, Platform, Scan, Twist, Value
from swarmd.driver_api.emulator import EmulatorFactory, OnCommand
from swarmd.driver_api.hw_codec import (
    MessageWire,
    decode_command,
    decode_messages,
    decode_neighbors,
    decode_odometry,
    decode_readings,
    decode_scan,
    encode_command,
    encode_message,
)
from swarmd.network.carriers.robot_link import Connection, Hello, dial, read_endpoint
from swarmd.settings.platforms import load_platform
from swarmd.sim.live.link import EmulatorTransport, WorldLink, WorldView
from swarmd.sim.live.realtime import COMMAND_TIMEOUT, RealTimeWorld
from swarmd.sim.live.recording import LiveRecorder, RecorderSettings
from swarmd.sim.live.state import WorldState
from swarmd.sim.trace import load_trace
from swarmd.sim.world.arena import Arena, Box
from swarmd.sim.world.radio import Radio, RadioSettings
from swarmd.sim.world.realism import IDEAL, Actuation, LidarNoise, Realism
from swarmd.sim.world.scalar_fields import Field, UniformField
from swarmd.sim.world.world import World
from tests.support.processes import wait_until

IDS = ("a", "b")
FOR_EVER = (math.inf, math.inf)


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
        self.values: list[tuple[str, Mapping[str, float]]] = []

    def scan(self, robot: str, scan: Scan) -> None:
        self.scans.append((robot, scan))

    def odometry(self, robot: str, odometry: Odometry) -> None:
        self.poses.append((robot, odometry))

    def readings(self, robot: str, values: Mapping[str, float]) -> None:
        self.values.append((robot, values))

    def close(self) -> None:
        pass


class ManualWorld:
    """Two Burgers in real time with a manual clock."""

    def __init__(
        self,
        settings: RecorderSettings,
        realism: Realism = IDEAL,
        radio: RadioSettings | None = None,
        fields: tuple[Field, ...] = (),
        boxes: tuple[Box, ...] = (),
        emulator: EmulatorFactory | None = None,
        command_timeouts: Sequence[float] | None = None,
    ) -> None:
        self.now = 100.0
        platform = load_platform("burger")
        starts = np.array([[0.0, 0.0, 0.0], [0.0, 2.0, 0.0]])
        robots, arena = dict.fromkeys(IDS, platform), Arena(6.0, 6.0, boxes)
        self.world = World(robots, arena, starts, realism=realism, fields=fields)
        self.link = WorldLink("s", IDS, "tcp/127.0.0.1:0", clock=lambda: self.now)
        self.recorder = LiveRecorder(self.world, settings)
        emulated = None
        if emulator is not None:
            emulated = EmulatorTransport(emulator, robots, "here", clock=lambda: self.now)
        self.server = RealTimeWorld(
            self.world,
            self.link,
            self.recorder,
            radio=None if radio is None else Radio(radio, IDS, arena, seed=0),
            emulated=emulated,
            command_timeouts=command_timeouts,
            clock=lambda: self.now,
        )

    def close(self) -> None:
        self.link.close()

    def pass_time(self, seconds: float) -> None:
        for _ in range(round(seconds / self.world.dt)):
            self.now += self.world.dt
            self.server.run_due()

    def speed(self, robot: int = 0) -> float:
        return float(self.world.twists()[robot, 0])


class EmulatedWorld(ManualWorld):
    """The bases of its robots stop after 0.5 s without a command, or never."""

    def __init__(self) -> None:
        super().__init__(
            RecorderSettings(), emulator=self._emulator, command_timeouts=(0.5, math.inf)
        )

    def _emulator(self, **values: Any) -> Side:
        self.side = Side(**values)
        return self.side

    def speeds(self) -> list[float]:
        return [self.speed(row) for row in (0, 1)]


class LiveWorld(ManualWorld):
    """A world with a peer that sends commands."""

    def __init__(self, settings: RecorderSettings, **values: Any) -> None:
        super().__init__(settings, **values)
        where = read_endpoint(self.link.endpoint, "")
        self.peers: dict[str, Connection] = {}
        self.heard: list[tuple[str, str, bytes]] = []
        for robot in IDS:
            made = dial(where, Hello("s", robot), 10.0)
            assert made is not None
            self.peers[robot] = made
        wait_until(lambda: {robot for robot, _, _ in self.hear()} == set(IDS), "welcome")
        self.heard.clear()

    def close(self) -> None:
        for one in self.peers.values():
            one.close()
        super().close()

    def hear(self) -> list[tuple[str, str, bytes]]:
        """All that daemons have been sent: robot, name and payload."""
        self.link.receive()
        for robot, one in self.peers.items():
            self.heard += [(robot, name, payload) for name, payload in one.receive()]
        return self.heard

    def put(self, robot: str, name: str, payload: bytes) -> None:
        """Send as the daemon of a robot."""
        self.peers[robot].send(name, payload)

    def command(self, robot: str, payload: bytes) -> None:
        """Send a command and wait until the world has received it."""
        wire = decode_command(payload)

        def has_arrived() -> bool:
            self.link.receive()
            command = self.link._commands.get(robot)
            return command is not None and command.scan_seq == wire.scan_seq

        self.link._commands.pop(robot, None)
        self.put(robot, "cmd_vel", payload)
        wait_until(has_arrived, "received")


Make = Callable[..., LiveWorld]


@pytest.fixture
def make() -> Iterator[Make]:
    """Makes live worlds, which end with the test."""
    with ExitStack() as worlds:

        def made(settings: RecorderSettings | None = None, **values: Any) -> LiveWorld:
            one = LiveWorld(settings or RecorderSettings(), **values)
            worlds.callback(one.close)
            return one

        yield made


@pytest.fixture
def live(make: Make) -> LiveWorld:
    return make()


def test_a_command_moves_its_robot_until_half_a_second_after_the_last(live: LiveWorld) -> None:
    live.command("a", encode_command(Twist(0.2), 1, 1))
    live.pass_time(COMMAND_TIMEOUT - 0.02)
    assert live.speed(0) == pytest.approx(0.2)
    assert live.speed(1) == 0.0
    live.pass_time(0.02 + 0.1)  # and the ramp down
    assert live.speed() == 0.0
    live.pass_time(5.0)
    assert live.speed() == 0.0
    newest = live.world._seq[0]
    live.command("a", encode_command(Twist(-0.1), newest, newest))
    live.pass_time(0.3)
    assert live.speed() == pytest.approx(-0.1)


def test_late_commands_of_a_frozen_daemon_do_not_move_its_base(live: LiveWorld) -> None:
    live.pass_time(3.0)
    newest = live.world._seq[0] - 1
    live.command("a", encode_command(Twist(0.2), newest - 4, newest - 4))
    live.pass_time(0.3)
    assert live.speed() == 0.0
    newest = live.world._seq[0] - 1
    live.command("a", encode_command(Twist(0.2), newest - 2, newest - 2))
    live.pass_time(0.1)
    assert live.speed() > 0.0


def test_a_malformed_command_is_counted_and_does_not_feed_the_timeout(live: LiveWorld) -> None:
    live.command("a", encode_command(Twist(0.2), 1, 1))
    live.pass_time(0.4)
    live.put("a", "cmd_vel", b"\x01rubbish")

    def counted() -> bool:
        live.link.receive()
        return live.link.dropped == 1

    wait_until(counted, "counted")
    live.pass_time(0.3)
    assert live.speed() == 0.0
    assert live.server._state().dropped == 1


def test_scans_and_odometry_come_at_their_rates_and_not_all_at_once(live: LiveWorld) -> None:
    heard: list[tuple[str, str, float]] = []

    def hear() -> None:
        spec = live.world.platforms[0].scan
        for robot, name, payload in live.hear():
            decoded = decode_scan(payload, spec) if name == "scan" else decode_odometry(payload)
            heard.append((robot, name, decoded.stamp))
        live.heard.clear()

    start = live.world.time + 0.001

    def all_published_since(moment: float) -> bool:
        hear()
        return {h[0] for h in list(heard) if h[1] == "odometry" and h[2] > moment} == set(IDS)

    for _ in range(100 + 1):
        # One odometry of each in 0.05 s: wait for both, so that nothing piles up and is dropped.
        end = live.world.time + 0.001
        live.pass_time(0.05)
        wait_until(lambda end=end: all_published_since(end), "published")  # type: ignore[misc]
    # What was sent before the last odometries has come before them.
    stamps = {
        (robot, name): {h[2] for h in heard if h[:2] == (robot, name) and start < h[2] <= end}
        for robot in IDS
        for name in ("scan", "odometry")
    }
    for robot in IDS:
        assert len(stamps[robot, "scan"]) == 25
        assert len(stamps[robot, "odometry"]) == 100
    assert not stamps["a", "scan"] & stamps["b", "scan"]


def received(live: LiveWorld, key: str) -> bytes:
    """The first payload on a key of robot a, while time passes."""
    came: list[bytes] = []

    def has_come() -> bool:
        live.pass_time(0.1)
        came.extend(one for robot, name, one in live.hear() if (robot, name) == ("a", key))
        return bool(came)

    wait_until(has_come, key)
    return came[-1]


@pytest.mark.parametrize(("reach", "heard"), [(1.5, []), (2.5, ["b"])])
def test_a_robot_receives_its_neighbors(make: Make, reach: float, heard: list[str]) -> None:
    live = make(radio=RadioSettings(neighborhood="range", range=reach), command_timeouts=FOR_EVER)
    live.command("b", encode_command(Twist(), 1, 1))
    neighbors = decode_neighbors(received(live, "neighbors"))
    assert [neighbor.id for neighbor in neighbors] == heard
    assert all(neighbor.distance is None for neighbor in neighbors)


def test_robots_whose_daemons_come_are_neighbors_of_each_other_from_then_on(
    make: Make, monkeypatch: pytest.MonkeyPatch
) -> None:
    radio = RadioSettings(neighborhood="range", range=2.5)
    live = make(radio=radio, command_timeouts=FOR_EVER)
    live.pass_time(0.5)
    told: dict[str, list[str]] = {}
    send = live.link.send

    def note(robot: str, name: str, value: Any) -> None:
        if name == "neighbors":
            told[robot] = [one.id for one in value]
        send(robot, name, value)

    monkeypatch.setattr(live.link, "send", note)
    live.command("a", encode_command(Twist(), 1, 1))
    live.command("b", encode_command(Twist(), 1, 1))
    live.pass_time(0.01)
    assert told == {"a": ["b"], "b": ["a"]}


def test_a_robot_without_a_daemon_is_no_neighbor(make: Make) -> None:
    live = make(radio=RadioSettings(range_and_bearing=True))
    assert decode_neighbors(received(live, "neighbors")) == ()


def test_range_and_bearing_is_measured_from_the_true_poses(make: Make) -> None:
    live = make(radio=RadioSettings(range_and_bearing=True), command_timeouts=FOR_EVER)
    live.command("b", encode_command(Twist(), 1, 1))
    (neighbor,) = decode_neighbors(received(live, "neighbors"))
    assert neighbor.distance == pytest.approx(2.0, abs=0.3)  # five standard deviations
    assert neighbor.bearing == pytest.approx(math.pi / 2.0, abs=0.2)


def test_a_message_reaches_the_others_after_the_delay_of_the_radio(make: Make) -> None:
    live = make(radio=RadioSettings(delay=0.3))
    came: list[MessageWire | None] = []

    def hear() -> bool:
        for robot, name, payload in live.hear():
            if (robot, name) == ("a", "received"):
                came.extend(decode_messages(payload))
            elif (robot, name) == ("a", "readings"):
                came.append(None)
        live.heard.clear()
        return bool(came)

    def arrived() -> bool:
        live.link.receive()
        return live.link.dropped == 1

    live.put("b", "sent", encode_message("b", "vote/opinion", b"x"))
    live.put("b", "sent", encode_message("a", "vote/opinion", b"of another"))
    wait_until(arrived, "both have arrived")
    live.pass_time(0.25)
    live.link.send("a", "readings", {})  # follows what was sent before
    wait_until(hear, "the mark")
    live.pass_time(0.1)
    wait_until(lambda: hear() and len(came) > 1, "the message")
    assert came == [None, MessageWire("b", "vote/opinion", b"x")]


def test_a_robot_receives_its_scalar_readings(make: Make) -> None:
    live = make(fields=(UniformField(name="light", value=0.5),))
    assert decode_readings(received(live, "readings")) == {"light": 0.5}


def test_a_delayed_scan_has_not_arrived(make: Make) -> None:
    live = make(realism=Realism(lidar=LidarNoise(latency=1.0), actuation=Actuation()))
    while live.world._seq[0] == 0:
        live.pass_time(0.01)
    taken = live.world.time
    assert live.server._sent_seq[0] == -1
    while live.server._sent_seq[0] == -1:
        live.pass_time(0.01)
    assert live.world.time - taken == pytest.approx(0.2)


def test_lost_time_is_given_up_after_a_freeze(live: LiveWorld) -> None:
    live.command("a", encode_command(Twist(0.2), 1, 1))
    live.pass_time(0.2)
    before = live.world.time
    live.now += 60.0
    live.server.run_due()
    assert live.world.time == pytest.approx(before + live.world.dt)
    live.pass_time(0.2)
    assert live.speed() == 0.0


def test_records_from_start_to_finish_only(make: Make, tmp_path: Path) -> None:
    path = tmp_path / "run.npz"
    live = make(RecorderSettings(path=path, meta={"seed": 7}))
    live.pass_time(1.0)
    live.recorder.begin()
    live.command("a", encode_command(Twist(0.2), 1, 1))
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


def test_recording_ends_by_itself_when_its_time_is_full(make: Make, tmp_path: Path) -> None:
    live = make(RecorderSettings(path=tmp_path / "run.npz", seconds=0.3))
    live.pass_time(1.0)
    state = live.server._state()
    assert not state.is_recording
    assert state.recorded == pytest.approx(0.3)
    assert load_trace(tmp_path / "run.npz").duration == pytest.approx(0.28, abs=0.03)


def test_touches_are_counted_and_recorded(make: Make, tmp_path: Path) -> None:
    live = make(RecorderSettings(path=tmp_path / "run.npz"))
    for _ in range(100):
        seq = live.world._seq[0]
        live.command("a", encode_command(Twist(0.22), seq, seq))
        live.pass_time(0.2)
    state = live.server._state()
    live.recorder.finish()
    assert (state.contacts, state.arena_contacts) == (0, 1)
    trace = load_trace(tmp_path / "run.npz")
    assert set(map(tuple, trace.contact_pair.tolist())) == {(0, -1)}
    assert trace.contact_speed[0, 0] == pytest.approx(0.22)


def asked(live: LiveWorld, deed: Callable[[WorldView], WorldState]) -> WorldState:
    """The reply to a viewer's request, done or refused."""
    with ThreadPoolExecutor(1) as pool, WorldView("s", live.link.viewers) as view:
        answer = pool.submit(deed, view)

        def is_answered() -> bool:
            live.pass_time(0.01)
            return answer.done()

        wait_until(is_answered, "answered")
        return answer.result()


def test_a_box_is_put_in_the_way_and_taken_out_of_it(make: Make, tmp_path: Path) -> None:
    crate = Box(0.0, 0.0, 0.2, 0.2, name="crate", mass=5.0, is_placed=False)
    live = make(RecorderSettings(path=tmp_path / "run.npz"), boxes=(crate,))
    state = asked(live, lambda view: view.place("crate", (1.0, 0.0, 0.0)))
    there = live.world.box_poses()[0].tolist()
    live.pass_time(0.5)  # some of which is recorded
    asked(live, lambda view: view.remove("crate"))
    live.recorder.finish()
    assert state.ids == IDS
    assert there == [1.0, 0.0, 0.0]
    assert np.isnan(live.world.box_poses()).all()
    poses = load_trace(tmp_path / "run.npz").box_pose
    assert poses is not None
    assert np.unique(poses[~np.isnan(poses[:, 0, 0]), 0], axis=0).tolist() == [[1.0, 0.0, 0.0]]


@pytest.mark.parametrize(
    ("box", "fault"),
    [("crate", "overlap a$"), ("create", "'create'.*'crate'")],
)
def test_a_box_that_cannot_be_placed_is_refused_with_the_reason(
    make: Make, box: str, fault: str
) -> None:
    crate = Box(0.0, 0.0, 0.2, 0.2, name="crate", mass=5.0, is_placed=False)
    live = make(boxes=(crate,))
    with pytest.raises(SwarmError, match=fault):
        asked(live, lambda view: view.place(box, (0.0, 0.0, 0.0)))
    assert live.server._state().dropped == 0


@pytest.fixture
def emulated() -> Iterator[EmulatedWorld]:
    one = EmulatedWorld()
    yield one
    one.close()


def test_every_robot_publishes_its_sensors_at_their_rates(emulated: EmulatedWorld) -> None:
    emulated.pass_time(2.0)
    for robot in IDS:
        assert len([r for r, _ in emulated.side.scans if r == robot]) in (9, 10)
        assert len([r for r, _ in emulated.side.poses if r == robot]) in (39, 40)
    assert all(len(scan.ranges) == 360 for _, scan in emulated.side.scans)


def test_an_emulated_base_stops_by_its_own_timeout_or_never(emulated: EmulatedWorld) -> None:
    for robot in IDS:
        emulated.side.command(robot, Twist(0.2))
    emulated.pass_time(0.45)
    assert emulated.speeds() == pytest.approx([0.2, 0.2])
    emulated.pass_time(1.0)
    assert emulated.speeds() == pytest.approx([0.0, 0.2], abs=1e-6)
    emulated.side.command("b", Twist())
    emulated.pass_time(0.5)
    assert emulated.speeds() == pytest.approx([0.0, 0.0], abs=1e-6)


def test_no_command_is_in_force_before_the_first(emulated: EmulatedWorld) -> None:
    emulated.pass_time(0.2)
    assert emulated.server._state().commanded == (False, False)
    emulated.side.command("b", Twist(0.1))
    emulated.pass_time(3.0)
    assert emulated.server._state().commanded == (False, True)
    assert emulated.server._state().dropped == 3


def test_only_the_newest_command_counts(emulated: EmulatedWorld) -> None:
    for speed in (0.1, 0.05, 0.2):
        emulated.side.command("a", Twist(speed))
    emulated.pass_time(0.3)
    assert emulated.speeds() == pytest.approx([0.2, 0.0], abs=1e-6)
