"""A guarded driver and its watchdog's two ends, with time handed in; as processes: tests/faults."""

from __future__ import annotations

import asyncio
import os
import secrets
import signal
import socket
from collections.abc import Iterator
from itertools import pairwise
from types import SimpleNamespace
from typing import Any

import pytest

from swarmd.core.errors import DriverError
from swarmd.core.finding import Finding
from swarmd.core.values import Twist
from swarmd.driver_api import watchdog as watchdog
from swarmd.driver_api import watchdog_client as guarded
from swarmd.driver_api.driver import Sink, ZeroSenderSpec
from swarmd.driver_api.watchdog import FAREWELL, FAULT, MAX_HINT, READY, TICK, ZEROS, Watchdog
from swarmd.driver_api.watchdog_client import WatchdogProcess, WatchedDriver
from swarmd.testing.driver_contract import TIMEOUT, CollectingSink

SPEC = ZeroSenderSpec("nowhere:nothing", {})


class Clock:
    """Seconds since boot, as the test says."""

    def __init__(self) -> None:
        self.now = 1000.0

    def __call__(self) -> float:
        return self.now


@pytest.fixture
def clock(monkeypatch: pytest.MonkeyPatch) -> Clock:
    made = Clock()
    monkeypatch.setattr(guarded, "boottime", made)
    monkeypatch.setattr(watchdog, "boottime", made)
    return made


@pytest.fixture
def far(monkeypatch: pytest.MonkeyPatch) -> Iterator[socket.socket]:
    """The watchdog's end of what a daemon opens; no process is started."""
    far_end, near_end = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
    far_end.setblocking(False)
    handed_on = socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET)
    sockets = SimpleNamespace(
        socketpair=lambda *_: (near_end, handed_on),
        AF_UNIX=socket.AF_UNIX,
        SOCK_SEQPACKET=socket.SOCK_SEQPACKET,
    )
    process = SimpleNamespace(poll=lambda: 0, wait=lambda: 0)
    monkeypatch.setattr("swarmd.driver_api.watchdog_client.socket", sockets)
    monkeypatch.setattr("subprocess.Popen", lambda *_, **__: process)
    with far_end, near_end, handed_on:
        yield far_end


def received(end: socket.socket) -> list[bytes]:
    found: list[bytes] = []
    while True:
        try:
            frame = end.recv(1024)
        except BlockingIOError:
            return found
        if not frame:
            return [*found, b"end"]
        found.append(frame)


# The daemon's end


def test_it_is_fed_a_tick_but_not_more_often_than_needed(clock: Clock, far: socket.socket) -> None:
    async def run() -> None:
        mine = WatchdogProcess(SPEC, name=None)
        fed = []
        for _ in range(5):
            mine.feed()
            fed.append(received(far))
            clock.now += 0.025
        assert fed == [[TICK], [], [TICK], [], [TICK]]
        mine.close()
        assert received(far) == [FAREWELL, b"end"]

    asyncio.run(asyncio.wait_for(run(), TIMEOUT))


def test_it_is_lost_once_it_has_not_answered_for_a_second(clock: Clock, far: socket.socket) -> None:
    async def run() -> None:
        mine = WatchdogProcess(SPEC, name=None)
        losing = asyncio.create_task(mine.lost())
        mine.feed()
        clock.now += 1.0
        mine.feed()
        far.send(TICK)
        clock.now += 1.0
        mine.feed()  # the answer had only waited for this loop
        await asyncio.sleep(0.0)
        assert not losing.done()
        clock.now += 1.001
        mine.feed()
        assert await losing == "has not answered for 1 s"
        mine.close()

    asyncio.run(asyncio.wait_for(run(), TIMEOUT))


@pytest.mark.parametrize(
    ("said", "why"), [(FAULT + b"no base there", "no base there"), (b"", "see the log")]
)
def test_one_that_cannot_be_ready_is_an_error(
    clock: Clock, far: socket.socket, said: bytes, why: str
) -> None:
    async def run() -> None:
        mine = WatchdogProcess(SPEC, name=None)
        if said:
            far.send(said)
        else:
            far.shutdown(socket.SHUT_RDWR)
        with pytest.raises(DriverError, match=why):
            await mine.start()
        mine.close()

    asyncio.run(asyncio.wait_for(run(), TIMEOUT))


@pytest.mark.integration
def test_a_watchdog_whose_sender_cannot_be_made_reports_why() -> None:
    async def run() -> None:
        mine = WatchdogProcess(SPEC, name=None)
        with pytest.raises(DriverError, match="nowhere"):
            await mine.start()
        mine.close()

    asyncio.run(asyncio.wait_for(run(), TIMEOUT))


# The watchdog's end


class Sender:
    """Counts the zeros; raises at the first if told to."""

    def __init__(self, clock: Clock, faults: int = 0) -> None:
        self.is_connected = True
        self.at: list[float] = []
        self.hints: list[str] = []
        self._clock, self._faults = clock, faults

    def open(self) -> None: ...

    def send_zero(self) -> None:
        self.at.append(round(self._clock.now - 1000.0, 3))
        if self._faults:
            self._faults -= 1
            raise OSError("no route to the robot")

    def take_hint(self, hint: str) -> None:
        self.hints.append(hint)

    def close(self) -> None: ...


@pytest.fixture
def daemon() -> Iterator[tuple[socket.socket, socket.socket]]:
    usual = signal.getsignal(signal.SIGTERM)
    near, far = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
    near.setblocking(False)
    with near, far:
        yield near, far
    signal.signal(signal.SIGTERM, usual)


def serve(clock: Clock, monkeypatch: pytest.MonkeyPatch, mine: Watchdog, until: float) -> None:
    """Let it serve until it is done, or that many seconds have passed, in steps of 10 ms."""

    class Over(Exception):
        pass

    def poll(seconds: float) -> None:
        if clock.now > 1000.0 + until:
            raise Over
        mine._read_ticks()
        clock.now = round(clock.now + 0.01, 3)

    monkeypatch.setattr(mine, "_poll", poll)
    try:
        mine.serve()
    except Over:
        return


def widest(times: list[float]) -> float:
    """s of the widest gap between two zeros: ZERO_PERIOD of 0.05 and a step of the clock."""
    return max(later - at for at, later in pairwise(times))


@pytest.mark.parametrize("faults", [0, 3])
def test_zeros_go_out_20_times_a_second_although_some_cannot_be_sent(
    clock: Clock,
    daemon: tuple[socket.socket, socket.socket],
    monkeypatch: pytest.MonkeyPatch,
    faults: int,
) -> None:
    sender = Sender(clock, faults)
    mine = Watchdog(daemon[1], sender, None, None)
    daemon[0].send(TICK)
    serve(clock, monkeypatch, mine, 3.0)
    assert received(daemon[0])[:2] == [READY + str(os.getpid()).encode(), TICK]
    assert sender.at[0] == pytest.approx(0.4, abs=0.011)
    assert 45 <= len(sender.at) <= 53
    assert sender.at[-1] > 2.9, "until the daemon is back"
    assert widest(sender.at) < 0.061


@pytest.mark.parametrize("word", [FAREWELL, b""])
def test_a_farewell_is_2_s_of_zeros_and_the_end_of_file_is_zeros_for_ever(
    clock: Clock,
    daemon: tuple[socket.socket, socket.socket],
    monkeypatch: pytest.MonkeyPatch,
    word: bytes,
) -> None:
    sender = Sender(clock)
    mine = Watchdog(daemon[1], sender, None, None)
    daemon[0].send(TICK)
    if word:
        daemon[0].send(word)
    daemon[0].close()
    serve(clock, monkeypatch, mine, 10.0)
    assert sender.at[0] < 0.011
    if word:
        assert sender.at[-1] == pytest.approx(2.0, abs=0.06)
    else:
        assert sender.at[-1] > 9.9
    assert widest(sender.at) < 0.061


def test_as_long_as_it_is_not_connected_the_daemon_is_to_say_zero(
    clock: Clock, daemon: tuple[socket.socket, socket.socket]
) -> None:
    sender = Sender(clock)
    mine = Watchdog(daemon[1], sender, None, None)
    for is_connected, answer in ((False, ZEROS), (True, TICK), (True, TICK)):
        sender.is_connected = is_connected
        daemon[0].send(TICK)
        mine._read_ticks()
        assert received(daemon[0]) == [answer]


def test_a_tick_hands_the_drivers_hint_to_the_sender_which_keeps_it(
    clock: Clock, daemon: tuple[socket.socket, socket.socket]
) -> None:
    sender = Sender(clock)
    mine = Watchdog(daemon[1], sender, None, None)
    for hint in (b"", b"Twist", b"Twist", b"", b"TwistStamped", b"x" * 40):
        daemon[0].send(TICK + hint)
        mine._read_ticks()
        assert received(daemon[0])[-1] == TICK
    assert sender.hints == ["Twist", "TwistStamped", "x" * MAX_HINT]


def test_only_a_watchdog_with_a_silent_daemon_is_relieved(
    clock: Clock, daemon: tuple[socket.socket, socket.socket], monkeypatch: pytest.MonkeyPatch
) -> None:
    name = f"swarmd/test/{secrets.token_hex(8)}"
    sender = Sender(clock)
    mine = Watchdog(daemon[1], sender, name, None)
    daemon[0].send(TICK)
    mine._read_ticks()
    monkeypatch.setattr(watchdog, "_CLAIM_TIMEOUT", 0.0)
    reliefs: list[float] = []
    monkeypatch.setattr(mine._timer, "relieve", lambda: reliefs.append(clock.now))
    for after, is_relieved in ((0.0, False), (0.39, False), (0.41, True)):
        clock.now = 1000.0 + after
        with pytest.raises(DriverError, match="another daemon"):
            Watchdog(daemon[1], sender, name, None)
        with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as other:
            other.sendto(b"relief", f"\0{name}")
        assert mine._name is not None
        mine._on_relief(mine._name)
        assert bool(reliefs) == is_relieved
    if mine._name is not None:
        mine._name.close()


# The driver between them


class Inner:
    """A driver that keeps what it is given, and how its life went."""

    is_simulated = False

    def __init__(self) -> None:
        self.story: list[str] = []

    async def run(self, sink: Sink) -> None:
        self.story.append("runs")
        try:
            await asyncio.Event().wait()
        finally:
            self.story.append("ends")

    def send(
        self, twist: Twist, scan_seq: int, requested_scan_seq: int, *, is_stopped: bool = False
    ) -> None:
        self.story.append(f"sends {twist.linear:g}" + " stopped" * is_stopped)

    async def check(self, seconds: float) -> tuple[Finding, ...]:
        return ()


class Process:
    """A watchdog's process that is ready when the test says so."""

    pid = 7
    requires_zero = False

    def __init__(self) -> None:
        self.story: list[str] = []
        self.ready: asyncio.Future[None] = asyncio.get_running_loop().create_future()
        self.end: asyncio.Future[str] = asyncio.get_running_loop().create_future()

    async def start(self) -> None:
        await self.ready

    async def lost(self) -> str:
        return await self.end

    def feed(self, hint: str = "") -> None:
        self.story.append("fed")

    def close(self) -> None:
        self.story.append("leave_beacon")

    def kill_if_frozen(self) -> None:
        self.story.append("buried")


@pytest.fixture
def started(monkeypatch: pytest.MonkeyPatch) -> list[Process]:
    """The watchdog processes that a driver has started."""
    made: list[Process] = []

    def start(spec: ZeroSenderSpec, **keywords: Any) -> Process:
        made.append(Process())
        return made[-1]

    monkeypatch.setattr(guarded, "WatchdogProcess", start)
    return made


def test_the_driver_lives_within_its_watchdog_and_each_command_feeds_it(
    started: list[Process],
) -> None:
    async def run() -> None:
        inner, heard = Inner(), CollectingSink()
        driver = WatchedDriver(inner, SPEC, name="n")
        task = asyncio.create_task(driver.run(heard))
        await asyncio.sleep(0.01)
        driver.send(Twist(0.1), 1, 1)
        assert inner.story == []
        assert heard.states == [(False, "waits for its watchdog")]
        (process,) = started
        process.ready.set_result(None)
        await asyncio.sleep(0.01)
        driver.send(Twist(0.1), 1, 1)
        process.requires_zero = True
        driver.send(Twist(0.1), 2, 2)
        driver.send(Twist(), 3, 3, is_stopped=True)
        assert inner.story == ["runs", "sends 0.1", "sends 0", "sends 0 stopped"]
        assert process.story == ["fed"] * 3
        process.end.set_result("has ended")
        with pytest.raises(DriverError, match="the watchdog has ended"):
            await task
        assert inner.story[4:] == ["ends"]
        driver.send(Twist(0.1), 4, 4)
        assert inner.story[5:] == []
        assert process.story == [*["fed"] * 3, "leave_beacon"]

    asyncio.run(asyncio.wait_for(run(), TIMEOUT))


def test_without_a_watchdog_the_driver_does_not_run(started: list[Process]) -> None:
    async def run() -> None:
        inner = Inner()
        task = asyncio.create_task(WatchedDriver(inner, SPEC, name="n").run(CollectingSink()))
        await asyncio.sleep(0.0)
        started[0].ready.set_exception(DriverError("no watchdog: see the log"))
        with pytest.raises(DriverError, match="no watchdog"):
            await task
        assert (inner.story, started[0].story) == ([], ["leave_beacon"])

    asyncio.run(asyncio.wait_for(run(), TIMEOUT))
