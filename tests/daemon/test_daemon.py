"""The daemon's own wiring, with a driver that only takes notes; whole daemons: tests/faults."""

from __future__ import annotations

import asyncio
from pathlib import Path

import pytest

from swarmd.core.codec import Decoder, encode
from swarmd.core.messages import AnyRequest, Code, EstopRequest, Reply, StopRequest
from swarmd.core.values import Twist
from swarmd.daemon.daemon import Daemon
from swarmd.daemon.latchfile import LatchFile
from swarmd.driver_api.driver import Finding, Sink
from swarmd.settings.settings import DaemonSettings, load_daemon_settings
from tests.support.processes import unique_swarm

pytestmark = pytest.mark.integration


class RecordingDriver:
    """A driver that keeps the commands that it gets."""

    is_simulated = True

    def __init__(self) -> None:
        self.sent: list[Twist] = []

    async def run(self, sink: Sink) -> None:
        sink.state(True, "recording")
        await asyncio.Event().wait()

    def send(self, twist: Twist, scan_seq: int, requested_scan_seq: int) -> None:
        self.sent.append(twist)

    async def check(self, seconds: float) -> tuple[Finding, ...]:
        return ()


def settings_in(folder: Path) -> DaemonSettings:
    values = {"id": "tb3-01", "swarm": unique_swarm(), "state_dir": str(folder)}
    return load_daemon_settings(None, values)


def test_zero_is_sent_at_20_hz_before_any_run(tmp_path: Path) -> None:
    driver = RecordingDriver()

    async def live() -> None:
        stop = asyncio.Event()
        daemon = Daemon(settings_in(tmp_path), driver)
        asyncio.get_running_loop().call_later(1.0, stop.set)
        await daemon.run(stop)

    asyncio.run(live())
    assert len(driver.sent) > 5
    assert all(twist.is_zero for twist in driver.sent)


class RecordingQuery:
    """A query that keeps its replies."""

    def __init__(self, request: AnyRequest) -> None:
        self.payload = encode(request)
        self.replies: list[Reply] = []

    def reply(self, payload: bytes) -> None:
        self.replies.append(Decoder(Reply)(payload))

    def drop(self) -> None:
        pass


def test_a_stop_is_taken_while_many_requests_are_pending(tmp_path: Path) -> None:
    queries = {
        kind: RecordingQuery(kind(id=f"h-{kind.__name__}", operator="alice"))
        for kind in (StopRequest, EstopRequest)
    }

    async def live() -> None:
        stop = asyncio.Event()
        daemon = Daemon(settings_in(tmp_path), RecordingDriver())
        for n in range(100):
            daemon._requests._pending[f"r{n}"] = RecordingQuery(
                StopRequest(id=f"r{n}", operator="bob")
            )
        for kind, query in queries.items():
            daemon._requests.handle("stop" if kind is StopRequest else "estop", query)
        stop.set()
        await daemon.run(stop)

    asyncio.run(live())
    for query in queries.values():
        assert [reply.code for reply in query.replies] == [Code.APPLIED]


def test_a_daemon_that_raises_sends_zero_and_ends(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    driver = RecordingDriver()

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


class Unplugged(RecordingDriver):
    """One whose commands cannot be sent any more, from some time on."""

    is_gone = False

    def send(self, twist: Twist, scan_seq: int, requested_scan_seq: int) -> None:
        if self.is_gone:
            raise OSError("unplugged")
        super().send(twist, scan_seq, requested_scan_seq)


def test_an_estop_is_stored_and_acked_if_zero_cannot_be_sent(tmp_path: Path) -> None:
    driver = Unplugged()
    query = RecordingQuery(EstopRequest(id="e1", operator="alice"))
    settings = settings_in(tmp_path)

    async def live() -> None:
        daemon = Daemon(settings, driver)

        def ask() -> None:
            driver.is_gone = True
            daemon._requests.handle("estop", query)

        asyncio.get_running_loop().call_later(0.5, ask)
        async with asyncio.timeout(30.0):
            await daemon.run(asyncio.Event())

    with pytest.raises(OSError, match="unplugged"):
        asyncio.run(live())
    assert [reply.code for reply in query.replies] == [Code.APPLIED]
    assert LatchFile(settings.state_dir / settings.network.swarm / settings.id).read()


@pytest.mark.parametrize("when", ["while it runs", "when it ends"])
def test_a_driver_that_takes_no_commands_ends_the_daemon(tmp_path: Path, when: str) -> None:
    driver = Unplugged()

    async def live() -> None:
        stop = asyncio.Event()
        daemon = Daemon(settings_in(tmp_path), driver)

        def unplug() -> None:
            driver.is_gone = True
            if when == "when it ends":
                stop.set()

        asyncio.get_running_loop().call_later(0.5, unplug)
        async with asyncio.timeout(30.0):
            await daemon.run(stop)

    with pytest.raises(OSError, match="unplugged"):
        asyncio.run(live())


def test_left_is_not_published_after_the_driver_raised(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    class Broken(RecordingDriver):
        async def run(self, sink: Sink) -> None:
            raise ZeroDivisionError("on purpose")

    published: list[str] = []

    async def live() -> None:
        daemon = Daemon(settings_in(tmp_path), Broken())
        monkeypatch.setattr(daemon, "_publish_left", lambda: published.append("left"))
        async with asyncio.timeout(30.0):
            await daemon.run(asyncio.Event())

    with pytest.raises(ZeroDivisionError, match="on purpose"):
        asyncio.run(live())
    assert published == []


def test_a_daemon_stopped_while_joining_never_serves(tmp_path: Path) -> None:
    driver = RecordingDriver()
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
