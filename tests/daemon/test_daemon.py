"""The daemon's own wiring, with a driver that only takes notes; whole daemons: tests/faults."""

from __future__ import annotations

import asyncio
import dataclasses
import errno
import logging
import math
import threading
from collections.abc import Callable
from contextlib import suppress
from functools import partial
from importlib.metadata import version
from pathlib import Path
from typing import NoReturn

import numpy as np
import pytest

from swarmd.core.clock import boottime
from swarmd.core.codec import Decoder, encode
from swarmd.core.events import (
    DriverInput,
    HostInput,
    Input,
    LeaveInput,
    NoteInput,
    OdometryInput,
    RangesInput,
    RequestInput,
    ScanInput,
    TickInput,
)
from swarmd.core.files import write_whole
from swarmd.core.finding import Finding
from swarmd.core.goal import GoalRecord
from swarmd.core.host_messages import HostDied
from swarmd.core.messages import Code, Epoch, Reply
from swarmd.core.values import Odometry, Pose, Scan, Twist
from swarmd.core.verbs import EstopRequest, LabelRequest, ParamRequest, StopRequest
from swarmd.daemon import store
from swarmd.daemon.daemon import Daemon
from swarmd.daemon.driver import make_driver
from swarmd.daemon.goal_service import STORE_TIME
from swarmd.daemon.store import LatchFile
from swarmd.driver_api.driver import Sink, TakeLate
from swarmd.driver_api.hw_codec import encode_odometry, encode_scan
from swarmd.drivers import simulated
from swarmd.link.datagram import Stop, pack, tag_of
from swarmd.link.peer import PeerActions, PeerProtocol, Summary
from swarmd.robot.actions import Actions
from swarmd.robot.robot import Robot
from swarmd.settings.settings import DaemonSettings, load_daemon_settings
from swarmd.settings.swarmfile import BlackboxSection
from swarmd.sim.live.link import WorldLink
from tests.support.processes import free_endpoint, unique_swarm, wait_until
from tests.support.viewer import Viewer

pytestmark = [pytest.mark.integration, pytest.mark.usefixtures("forked_starts")]


ESTOP = Stop(id="e1", verb="estop", operator="alice")
STOP = Stop(id="s1", verb="stop", operator="alice", targets=("tb3-01",))


class RecordingDriver:
    """A driver that keeps the commands that it gets."""

    is_simulated = True

    def __init__(self) -> None:
        self.sent: list[Twist] = []

    async def run(self, sink: Sink) -> None:
        sink.state(True, "recording")
        await asyncio.Event().wait()

    def send(
        self, twist: Twist, scan_seq: int, requested_scan_seq: int, *, is_stopped: bool = False
    ) -> None:
        self.sent.append(twist)

    async def check(self, seconds: float) -> tuple[Finding, ...]:
        return ()


@pytest.fixture
def settings(tmp_path: Path) -> DaemonSettings:
    values: dict[str, object] = {
        "id": "tb3-01",
        "swarm": unique_swarm(),
        "state_dir": str(tmp_path),
    }
    values["blackbox"] = {"seconds": 0}  # these tests replace parts of the robot, which it keeps
    return load_daemon_settings(None, values)


async def run(
    daemon: Daemon, stop: asyncio.Event | None = None, later: Callable[[], object] = bool
) -> None:
    """The daemon's whole life; `later` is called once it has joined its swarm."""
    loop = asyncio.get_running_loop()

    def await_join() -> None:
        if daemon._has_joined:
            later()
        else:
            loop.call_later(0.01, await_join)

    await_join()
    async with asyncio.timeout(60.0):
        await daemon.run(stop or asyncio.Event())


async def test_zero_is_sent_again_and_again_before_any_run(settings: DaemonSettings) -> None:
    driver, stop = RecordingDriver(), asyncio.Event()

    def end_if_sent() -> None:
        if len(driver.sent) > 5:
            stop.set()
        else:
            asyncio.get_running_loop().call_later(0.05, end_if_sent)

    await run(Daemon(settings, driver), stop, end_if_sent)
    assert all(twist.is_zero for twist in driver.sent)


class RealDriver(RecordingDriver):
    is_simulated = False


@pytest.mark.parametrize("kind", [RecordingDriver, RealDriver])
async def test_the_tick_alone_repeats_a_command(
    settings: DaemonSettings, monkeypatch: pytest.MonkeyPatch, kind: type[RecordingDriver]
) -> None:
    driver, stop = kind(), asyncio.Event()
    daemon = Daemon(settings, driver)
    scan = Scan(1, 1.0, np.ones(1), np.zeros(1), 0.1, 3.5)
    counts: list[int] = []

    def answer(speed: float) -> None:
        actions = Actions(Twist(speed), daemon._robot.decision, is_quiet=True)
        monkeypatch.setattr(daemon._robot, "step", lambda input, now: actions)

    def count(*steps: Callable[[], object]) -> None:
        before = len(driver.sent)
        for step in steps:
            step()
        counts.append(len(driver.sent) - before)

    def feed() -> None:
        frequent: list[Input] = [ScanInput(scan), RangesInput(scan), HostInput(HostDied(0, "gone"))]
        steps = [partial(daemon.step, one) for one in frequent]
        answer(0.1)
        count(steps[0])
        count(*steps, daemon._on_tick)  # woken between two ticks
        daemon._timer.periods += 1
        count(daemon._on_tick)
        count(lambda: daemon.step(DriverInput(True, "back")))
        answer(0.2)
        count(steps[2])
        stop.set()

    await run(daemon, stop, feed)
    assert counts == [1, 0, 1, 1, 1]


class GatheringDriver(RecordingDriver):
    """A recording driver that keeps one reading of odometry back, which arrived 10 s ago."""

    def __init__(self) -> None:
        super().__init__()
        self.take_late: TakeLate | None = None

    def gather(self, take_late: TakeLate) -> None:
        self.take_late = take_late

    def read(self) -> None:
        if self.take_late is not None:
            self.take_late(OdometryInput(Odometry(1.0, Pose(), Twist())), 10.0)


PARAM = ParamRequest(id="p1", operator="anna", targets={"tb3-01": None}, params={"speed": 0.1})


def _stopping(kind: type[StopRequest] | type[EstopRequest]) -> RequestInput:
    return RequestInput(kind(id="s1", operator="anna"))


async def inputs_of(
    settings: DaemonSettings,
    monkeypatch: pytest.MonkeyPatch,
    act: Callable[[Daemon], object],
) -> list[tuple[type[Input], float]]:
    """The kinds and times of the inputs of the robot in `act`, while its driver gathers."""
    driver, stop = GatheringDriver(), asyncio.Event()
    daemon = Daemon(settings, driver)
    taken: list[tuple[type[Input], float]] = []
    original = daemon._robot.step

    def step(input: Input, now: float) -> Actions | None:
        taken.append((type(input), now))
        return original(input, now)

    def when_gathering() -> None:
        if driver.take_late is None:
            asyncio.get_running_loop().call_later(0.05, when_gathering)
            return
        monkeypatch.setattr(daemon._robot, "step", step)
        act(daemon)
        monkeypatch.setattr(daemon._robot, "step", original)
        stop.set()

    await run(daemon, stop, when_gathering)
    return taken


@pytest.mark.parametrize(
    "input",
    [TickInput(), HostInput(HostDied(0, "gone")), NoteInput("an event"), RequestInput(PARAM)],
)
async def test_a_decision_is_made_with_all_odometry_that_has_arrived(
    settings: DaemonSettings, monkeypatch: pytest.MonkeyPatch, input: Input
) -> None:
    (first, arrived), (second, now) = await inputs_of(
        settings, monkeypatch, lambda daemon: daemon.step(input)
    )
    assert (first, second) == (OdometryInput, type(input))
    assert arrived <= now - 10.0


@pytest.mark.parametrize("input", [_stopping(StopRequest), _stopping(EstopRequest), LeaveInput()])
async def test_a_stop_waits_for_no_odometry(
    settings: DaemonSettings, monkeypatch: pytest.MonkeyPatch, input: Input
) -> None:
    taken = await inputs_of(settings, monkeypatch, lambda daemon: daemon.step(input))
    assert [kind for kind, _ in taken] == [type(input)]


async def test_odometry_of_a_simulated_robot_is_taken_with_a_scan_or_a_tick_alone(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    swarm, endpoint = unique_swarm(), free_endpoint()
    values: dict[str, object] = {
        "id": "tb3-01",
        "swarm": swarm,
        "state_dir": str(tmp_path),
        "driver": "simulated",
        "driver_options": {"endpoint": endpoint},
        "blackbox": {"seconds": 0},
    }
    settings, stop = load_daemon_settings(None, values), asyncio.Event()
    daemon, link = Daemon(settings, make_driver(settings)), WorldLink(swarm, ("tb3-01",), endpoint)
    taken: list[type[Input]] = []
    original, spec = daemon._robot.step, settings.platform.scan

    def step(input: Input, now: float) -> Actions | None:
        taken.append(type(input))
        return original(input, now)

    def publish_odometry(stamp: float) -> None:
        link.receive()  # the driver may have connected meanwhile
        link.publish("tb3-01", "odometry", encode_odometry(Odometry(stamp, Pose(), Twist())))

    async def feed() -> list[list[type[Input]]]:
        """What the robot takes in the turns of the loop after each of some readings."""
        while taken.count(ScanInput) < 2 or OdometryInput not in taken:
            publish_odometry(1.0)
            ranges = np.full(len(spec.bearings), 1.5)
            scan = Scan(len(taken), 1.0, ranges, spec.bearings, spec.range_min, spec.range_max)
            link.publish("tb3-01", "scan", encode_scan(scan))
            await asyncio.sleep(0.1)
        taken.clear()
        after: list[list[type[Input]]] = []
        while taken.count(OdometryInput) < 10:
            before = len(taken)
            publish_odometry(2.0 + 0.01 * len(after))
            for _ in range(5):
                await asyncio.sleep(0.0)
            after.append(taken[before:])
            await asyncio.sleep(0.03)
        return after

    # A driver that got nothing for a second looks into its socket; this process may stand still.
    monkeypatch.setattr(simulated, "SENSOR_TIMEOUT", 1000.0)
    monkeypatch.setattr(daemon._robot, "step", step)
    feeding = asyncio.create_task(feed())
    feeding.add_done_callback(lambda _: stop.set())
    try:
        await run(daemon, stop)
    finally:
        feeding.cancel()
        link.close()
    assert not [inputs for inputs in await feeding if set(inputs) == {OdometryInput}]


async def test_every_second_tick_looks_at_the_network_and_each_tick_after_an_event(
    settings: DaemonSettings, monkeypatch: pytest.MonkeyPatch
) -> None:
    daemon, stop = Daemon(settings, RecordingDriver()), asyncio.Event()
    waits: list[bool] = []

    def count_waits() -> int:
        waits.clear()
        for _ in range(6):
            daemon._timer.periods += 1
            daemon._on_tick()
        return waits.count(True)

    counts: list[int] = []

    def look() -> None:
        monkeypatch.setattr(daemon._network, "advance", lambda *, may_wait: waits.append(may_wait))
        for input in (NoteInput("an event"), HostInput(HostDied(0, "gone"))):
            daemon._active_until = 0.0
            counts.append(count_waits())
            daemon.step(input)
            counts.append(count_waits())
        stop.set()

    await run(daemon, stop, look)
    assert counts == [3, 0, 3, 3]


@pytest.mark.parametrize(
    ("wake_at", "may_wait", "is_looked_at"),
    [(math.inf, True, False), (math.inf, False, True), (-math.inf, True, True)],
    ids=["later", "later, at once", "due"],
)
async def test_what_is_due_on_the_network_never_waits(
    settings: DaemonSettings,
    monkeypatch: pytest.MonkeyPatch,
    wake_at: float,
    may_wait: bool,
    is_looked_at: bool,
) -> None:
    daemon, stop = Daemon(settings, RecordingDriver()), asyncio.Event()
    looks: list[float] = []
    counts: list[int] = []  # of looks by the one call below, and not by a tick after it

    def look() -> None:
        peer = daemon._network._protocol
        assert peer is not None
        advance = peer.advance

        def noted(now: float, summary: Summary) -> PeerActions:
            looks.append(now)
            return advance(now, summary)

        with monkeypatch.context() as here:
            here.setattr(peer, "wake_at", lambda: wake_at)
            here.setattr(peer, "advance", noted)
            daemon._network.advance(may_wait=may_wait)
        counts.append(len(looks))
        stop.set()

    await run(daemon, stop, look)
    assert counts == [int(is_looked_at)]


class GrippingDriver(RecordingDriver):
    """A recording driver whose base has a gripper."""

    def grip(self, is_closed: bool) -> None:
        pass


@pytest.mark.parametrize(("kind", "has"), [(RecordingDriver, False), (GrippingDriver, True)])
async def test_a_robot_whose_driver_has_no_gripper_provides_none(
    settings: DaemonSettings, kind: type[RecordingDriver], has: bool
) -> None:
    platform = settings.platform
    platform = dataclasses.replace(platform, provides=platform.provides | {"gripper"})
    daemon, stop = Daemon(dataclasses.replace(settings, platform=platform), kind()), asyncio.Event()
    await run(daemon, stop, stop.set)
    assert ("gripper" in daemon._robot.platform.provides) is has


async def test_a_daemon_that_raises_sends_zero_and_ends(
    settings: DaemonSettings, monkeypatch: pytest.MonkeyPatch
) -> None:
    driver = RecordingDriver()
    daemon = Daemon(settings, driver)

    def broken(input: Input, now: float) -> None:
        driver.sent.append(Twist(0.2))
        raise ZeroDivisionError("on purpose")

    with pytest.raises(ZeroDivisionError, match="on purpose"):
        await run(daemon, later=lambda: monkeypatch.setattr(daemon._robot, "step", broken))
    assert driver.sent[-1].is_zero


class Question:
    """A request on a link, for the robot tb3-01."""

    asker, source = "anna", "10.0.0.5:40000"

    def __init__(self, payload: bytes) -> None:
        self.payload = payload
        self.replies: list[Reply] = []

    def reply(self, payload: bytes) -> None:
        self.replies.append(Decoder(Reply)(payload))

    def drop(self) -> None:
        pass


def _broken(*args: object, **options: object) -> NoReturn:
    raise ZeroDivisionError("on purpose")


def _broken_by(kind: type[Input]) -> Callable[[Robot, Input, float], Actions | None]:
    """`Robot.step` that raises for one kind of input."""
    step = Robot.step

    def broken(robot: Robot, input: Input, now: float) -> Actions | None:
        return _broken() if isinstance(input, kind) else step(robot, input, now)

    return broken


def _label(daemon: Daemon) -> Question:
    targets: dict[str, Epoch | None] = {"tb3-01": daemon._robot.epoch}
    return Question(encode(LabelRequest(id="l1", operator="anna", targets=targets, labels=None)))


async def test_an_error_of_the_robot_in_a_request_ends_the_daemon(
    settings: DaemonSettings, monkeypatch: pytest.MonkeyPatch
) -> None:
    driver = RecordingDriver()
    daemon = Daemon(settings, driver)
    monkeypatch.setattr(Robot, "step", _broken_by(RequestInput))
    with pytest.raises(ZeroDivisionError, match="on purpose"):
        await run(daemon, later=lambda: daemon._requests.handle("label", _label(daemon)))
    assert driver.sent[-1].is_zero


async def test_an_error_of_the_robot_in_a_reading_of_its_driver_ends_the_daemon(
    settings: DaemonSettings, monkeypatch: pytest.MonkeyPatch
) -> None:
    driver = RecordingDriver()
    monkeypatch.setattr(Robot, "step", _broken_by(DriverInput))
    with pytest.raises(ZeroDivisionError, match="on purpose"):
        await run(Daemon(settings, driver))
    assert driver.sent[-1].is_zero


async def test_an_error_beside_the_robot_fails_the_request(
    settings: DaemonSettings, monkeypatch: pytest.MonkeyPatch
) -> None:
    stop = asyncio.Event()
    daemon = Daemon(settings, RecordingDriver())
    monkeypatch.setattr(daemon._goals, "refusal_of", _broken)
    question = _label(daemon)

    def ask() -> None:
        daemon._requests.handle("label", question)
        stop.set()

    await run(daemon, stop, ask)
    assert [(reply.code, reply.refusal) for reply in question.replies] == [(Code.FAILED, None)]
    assert daemon._drops.counts() == {"control/label:failed": 1}


async def test_a_stop_that_cannot_be_handled_ends_the_daemon(
    settings: DaemonSettings, monkeypatch: pytest.MonkeyPatch
) -> None:
    daemon = Daemon(settings, RecordingDriver())
    monkeypatch.setattr(daemon._requests, "stop", _broken)
    payload = pack(tag_of("dev", settings.network.swarm), ESTOP)
    with pytest.raises(ZeroDivisionError, match="on purpose"):
        await run(
            daemon,
            later=lambda: daemon._network.on_datagram(payload, ("127.0.0.9", 7441), False),
        )


class Unplugged(RecordingDriver):
    """A driver that cannot send commands any more, from `unplug` on."""

    is_gone = False

    def unplug(self) -> None:
        self.is_gone = True

    def send(
        self, twist: Twist, scan_seq: int, requested_scan_seq: int, *, is_stopped: bool = False
    ) -> None:
        if self.is_gone:
            raise OSError("unplugged")
        super().send(twist, scan_seq, requested_scan_seq, is_stopped=is_stopped)


async def test_an_estop_is_stored_and_acked_if_zero_cannot_be_sent(
    settings: DaemonSettings,
) -> None:
    driver = Unplugged()
    replies: list[Reply] = []
    daemon = Daemon(settings, driver)

    def ask() -> None:
        driver.unplug()
        daemon._requests.stop(ESTOP, "10.0.0.5", replies.append)

    with pytest.raises(OSError, match="unplugged"):
        await run(daemon, later=ask)
    assert [reply.code for reply in replies] == [Code.APPLIED]
    assert LatchFile(settings.state_dir / settings.network.swarm / settings.id).read().held


async def test_a_request_is_in_the_log_and_in_the_events(
    settings: DaemonSettings, caplog: pytest.LogCaptureFixture
) -> None:
    caplog.set_level(logging.INFO)
    stop = asyncio.Event()
    daemon = Daemon(settings, RecordingDriver())
    assert daemon._robot.status(boottime()).version == version("swarmd")
    events: list[str] = []

    def ask() -> None:
        daemon._requests.stop(ESTOP, "10.0.0.5", lambda reply: None)
        events.extend(event.text for event in daemon._robot.status(boottime()).events)
        stop.set()

    await run(daemon, stop, ask)
    line = "estop to all robots, by alice from 10.0.0.5: applied"
    assert any(text.startswith(line) for text in events), events
    assert any(text.startswith(line) for text in caplog.messages), caplog.messages


async def test_a_disk_that_takes_no_write_stops_no_tick(
    settings: DaemonSettings, monkeypatch: pytest.MonkeyPatch
) -> None:
    driver, stop = RecordingDriver(), asyncio.Event()
    is_open, asked = threading.Event(), list[str]()

    def write(path: Path, content: bytes) -> None:
        asked.append(path.name)
        assert is_open.wait(60.0)

    monkeypatch.setattr(store, "write_whole", write)
    daemon = Daemon(settings, driver)

    async def change() -> None:
        daemon._goals.store(GoalRecord())
        daemon._pattern_versions.save()
        while len(asked) < 2:
            await asyncio.sleep(0.01)
        count = len(driver.sent)
        while len(driver.sent) < count + 20:
            await asyncio.sleep(0.01)
        is_open.set()
        stop.set()

    changes: list[asyncio.Task[None]] = []
    await run(daemon, stop, lambda: changes.append(asyncio.create_task(change())))
    await changes[0]
    assert set(asked) >= {"goal", "record"}


@pytest.mark.parametrize("is_written", [True, False])
async def test_a_stop_is_acked_when_a_restart_would_not_forget_it(
    settings: DaemonSettings, monkeypatch: pytest.MonkeyPatch, is_written: bool
) -> None:
    stop, is_open = asyncio.Event(), threading.Event()
    replies: list[Reply] = []
    early: list[int] = []

    def write(path: Path, content: bytes) -> None:
        assert is_open.wait(60.0)
        if not is_written:
            raise OSError(errno.ENOSPC, "full")
        write_whole(path, content)

    monkeypatch.setattr(store, "write_whole", write)
    daemon = Daemon(settings, RecordingDriver())

    async def ask() -> None:
        daemon._requests.stop(STOP, "10.0.0.5", replies.append)
        await asyncio.sleep(0.05)
        early.append(len(replies))
        is_open.set()
        while not replies:
            await asyncio.sleep(0.01)
        took.append(boottime() - began)
        stop.set()

    asked: list[asyncio.Task[None]] = []
    began, took = boottime(), list[float]()
    await run(daemon, stop, lambda: asked.append(asyncio.create_task(ask())))
    await asked[0]
    assert early == [0]
    assert [reply.code for reply in replies] == [Code.APPLIED]
    is_late = took[0] > STORE_TIME  # as on a disk that takes longer
    assert ("not on disk" in replies[0].text) is not is_written or is_late


@pytest.mark.parametrize("ends", [False, True])
async def test_a_driver_that_takes_no_commands_ends_the_daemon(
    settings: DaemonSettings, ends: bool
) -> None:
    driver, stop = Unplugged(), asyncio.Event()

    def unplug() -> None:
        driver.unplug()
        if ends:
            stop.set()

    with pytest.raises(OSError, match="unplugged"):
        await run(Daemon(settings, driver), stop, unplug)


async def test_a_daemon_whose_driver_raised_does_not_leave_in_order(
    settings: DaemonSettings,
) -> None:
    class Broken(RecordingDriver):
        async def run(self, sink: Sink) -> None:
            raise ZeroDivisionError("on purpose")

    with Viewer(settings.network) as viewer:
        with pytest.raises(ZeroDivisionError, match="on purpose"):
            await run(Daemon(settings, Broken()))
        wait_until(lambda: "tb3-01" in viewer.beacons, "its beacon is heard")
        await asyncio.sleep(0.2)
        assert viewer.beacons["tb3-01"].flags == 0


async def test_a_daemon_stopped_while_joining_never_serves(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """In profile field a claim settles for 1 s."""
    driver, stop = RecordingDriver(), asyncio.Event()
    values: dict[str, object] = {"profile": "field", "interface": "lo", "insecure": True}
    values["listen"] = ["tcp/127.0.0.1:0"]
    slow = {"id": "tb3-01", "swarm": unique_swarm(), "state_dir": str(tmp_path), **values}
    daemon = Daemon(load_daemon_settings(None, slow), driver)
    claim, claimed = daemon._network._claim, list[str]()

    async def stopped(peer: PeerProtocol) -> None:
        stop.set()
        claimed.append("begun")
        await claim(peer)

    monkeypatch.setattr(daemon._network, "_claim", stopped)
    await run(daemon, stop)
    assert claimed == ["begun"]
    assert not daemon._network.owns_id
    assert all(twist.is_zero for twist in driver.sent)


async def test_the_black_box_keeps_what_a_robot_without_scans_does(
    settings: DaemonSettings, tmp_path: Path
) -> None:
    section = BlackboxSection(folder=str(tmp_path / "memory"))
    daemon = Daemon(dataclasses.replace(settings, blackbox=section), RecordingDriver())
    stop = asyncio.Event()

    async def wait() -> None:
        ring = daemon._recorder.black_box.ring
        assert ring is not None
        with suppress(TimeoutError):
            async with asyncio.timeout(10.0):
                while ring.begin is None:
                    await asyncio.sleep(0.01)
        kept.append(ring.begin)
        stop.set()

    kept: list[float | None] = []
    tasks: list[asyncio.Task[None]] = []
    await run(daemon, stop, lambda: tasks.append(asyncio.ensure_future(wait())))
    await tasks[0]
    assert kept[0] is not None
