"""The daemon's own wiring, with a driver that only takes notes; whole daemons: tests/faults."""

from __future__ import annotations

import asyncio
from pathlib import Path

import pytest

from swarmd.codec import Decoder, encode
from swarmd.daemon import Daemon
from swarmd.driver import Finding, Sink
from swarmd.messages import Code, Reply, Request
from swarmd.settings import DaemonSettings, load_daemon_settings
from swarmd.testing.processes import unique_swarm
from swarmd.values import Twist

pytestmark = pytest.mark.integration


class Notes:
    """A driver that keeps what it is given."""

    is_simulated = True

    def __init__(self) -> None:
        self.sent: list[Twist] = []

    async def run(self, sink: Sink) -> None:
        sink.state(True, "taking notes")
        await asyncio.Event().wait()

    def send(self, twist: Twist, scan_seq: int, wish_seq: int) -> None:
        self.sent.append(twist)

    async def check(self, seconds: float) -> tuple[Finding, ...]:
        return ()


def settings_in(folder: Path) -> DaemonSettings:
    values = {"id": "tb3-01", "swarm": unique_swarm(), "state_dir": str(folder)}
    return load_daemon_settings(None, values)


def test_zero_goes_out_twenty_times_a_second_before_anyone_asks(tmp_path: Path) -> None:
    driver = Notes()

    async def live() -> None:
        stop = asyncio.Event()
        daemon = Daemon(settings_in(tmp_path), driver)
        asyncio.get_running_loop().call_later(1.0, stop.set)
        await daemon.run(stop)

    asyncio.run(live())
    assert len(driver.sent) > 5
    assert all(twist.is_zero for twist in driver.sent)


class Asked:
    """A query that takes notes."""

    def __init__(self, request: Request) -> None:
        self.payload = encode(request)
        self.replies: list[Reply] = []

    def reply(self, payload: bytes) -> None:
        self.replies.append(Decoder(Reply)(payload))

    def drop(self) -> None:
        pass


def test_a_halt_is_taken_however_many_requests_wait_for_their_answers(tmp_path: Path) -> None:
    halts = {
        verb: Asked(Request(id=f"h-{verb}", operator="alice", verb=verb))
        for verb in ("stop", "estop")
    }

    async def live() -> None:
        stop = asyncio.Event()
        daemon = Daemon(settings_in(tmp_path), Notes())
        for n in range(100):
            waiting = Request(id=f"r{n}", operator="bob", verb="run")
            daemon._pending[waiting.id] = Asked(waiting)
        for verb, asked in halts.items():
            daemon._on_request(verb)(asked)
        stop.set()
        await daemon.run(stop)

    asyncio.run(live())
    for asked in halts.values():
        assert [reply.code for reply in asked.replies] == [Code.APPLIED]


def test_a_guardian_that_raises_sends_zero_and_ends(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    driver = Notes()

    async def live() -> None:
        daemon = Daemon(settings_in(tmp_path), driver)

        def broken(now: float) -> None:
            driver.sent.append(Twist(0.2))
            raise ZeroDivisionError("on purpose")

        loop = asyncio.get_running_loop()
        loop.call_later(0.5, lambda: monkeypatch.setattr(daemon._robot, "tick", broken))
        async with asyncio.timeout(30.0):
            await daemon.run(asyncio.Event())

    with pytest.raises(ZeroDivisionError, match="on purpose"):
        asyncio.run(live())
    assert driver.sent[-1].is_zero


def test_a_daemon_that_is_told_to_end_while_it_joins_never_serves(tmp_path: Path) -> None:
    driver = Notes()
    values = {"profile": "field", "interface": "lo", "listen": ["tcp/127.0.0.1:0"]}
    slow = {"id": "tb3-01", "swarm": unique_swarm(), "state_dir": str(tmp_path), **values}

    async def live() -> bool:
        stop = asyncio.Event()
        daemon = Daemon(load_daemon_settings(None, slow), driver)
        asyncio.get_running_loop().call_later(0.3, stop.set)
        async with asyncio.timeout(30.0):
            await daemon.run(stop)
        return daemon._claim is None

    assert asyncio.run(live())
    assert all(twist.is_zero for twist in driver.sent)
