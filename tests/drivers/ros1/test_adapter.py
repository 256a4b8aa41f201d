"""Driver `ros1` with a fake adapter; needs no ROS."""

from __future__ import annotations

import asyncio
import errno
import os
import signal
import socket
import sys
from collections.abc import Awaitable, Callable
from pathlib import Path

import pytest

from swarmd.core.values import Value
from swarmd.drivers.ros1 import adapter as ros1_child
from swarmd.drivers.ros1 import adapter_process as ros1_adapter
from swarmd.drivers.ros1.driver import Ros1Driver
from swarmd.settings.platforms import load_platform
from swarmd.testing.driver_contract import TIMEOUT, CollectingSink, is_running

FAKE_ADAPTER = Path(__file__).with_name("fake_adapter.py")
PLATFORM = load_platform("burger")


def make(**options: Value) -> Ros1Driver:
    return Ros1Driver(swarm="s", robot="r", platform=PLATFORM, options=options)


def play(
    monkeypatch: pytest.MonkeyPatch,
    kind: str,
    story: Callable[[Ros1Driver, CollectingSink], Awaitable[None]],
    **options: Value,
) -> None:
    monkeypatch.setattr(ros1_adapter, "__file__", str(FAKE_ADAPTER))
    monkeypatch.setenv("FAKE_ADAPTER", kind)

    async def run() -> None:
        driver, sink = make(**{"python": sys.executable, **options}), CollectingSink()
        task = asyncio.create_task(driver.run(sink))
        try:
            async with asyncio.timeout(TIMEOUT):
                await story(driver, sink)
        finally:
            pid = driver.adapter_pid
            task.cancel()
            await asyncio.gather(task, return_exceptions=True)
            assert pid is None or not is_running(pid)

    asyncio.run(run())


async def until(condition: Callable[[], bool]) -> None:
    while not condition():
        await asyncio.sleep(0.01)


def texts(sink: CollectingSink) -> list[str]:
    return [text for _, text in sink.states]


def test_garbage_is_counted_and_later_events_are_read(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    async def story(driver: Ros1Driver, sink: CollectingSink) -> None:
        await until(lambda: any("a fake adapter" in text for text in texts(sink)))
        assert sink.lost.count("ros1/garbage") >= 60
        assert not sink.is_up
        assert not sink.scans

    play(monkeypatch, "garbage", story)


def test_the_last_words_of_an_adapter_are_reported(monkeypatch: pytest.MonkeyPatch) -> None:
    async def story(driver: Ros1Driver, sink: CollectingSink) -> None:
        await until(lambda: any("it cannot go on" in text for text in texts(sink)))

    play(monkeypatch, "dies", story)


def test_a_silent_adapter_is_killed(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(ros1_child, "START_TIMEOUT", 0.3)

    async def story(driver: Ros1Driver, sink: CollectingSink) -> None:
        await until(lambda: any("SIGKILL" in text for text in texts(sink)))
        assert any("did not answer" in text for text in texts(sink))

    play(monkeypatch, "mute", story)


def test_an_adapter_that_does_not_leave_is_killed(monkeypatch: pytest.MonkeyPatch) -> None:
    async def story(driver: Ros1Driver, sink: CollectingSink) -> None:
        await until(lambda: any("a fake adapter" in text for text in texts(sink)))
        assert driver.adapter_pid is not None  # `play` sees that it has ended

    play(monkeypatch, "deaf", story)


def test_a_full_machine_ends_no_daemon(monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse(*_: object) -> None:
        raise OSError(errno.EMFILE, "Too many open files")

    async def story(driver: Ros1Driver, sink: CollectingSink) -> None:
        await until(lambda: driver.adapter_pid is not None)
        with monkeypatch.context() as full:
            full.setattr(socket, "socketpair", refuse)
            os.kill(driver.adapter_pid or 0, signal.SIGKILL)
            await until(lambda: any("is the machine full?" in text for text in texts(sink)))
        await until(lambda: driver.adapter_pid is not None)

    play(monkeypatch, "mute", story)


@pytest.mark.parametrize(
    ("python", "remedy"),
    [("/no/python3", "set driver_options.python"), (sys.executable, "install python3-rospy")],
)
def test_an_interpreter_without_rospy_is_named(
    monkeypatch: pytest.MonkeyPatch, python: str, remedy: str
) -> None:
    monkeypatch.setenv("PYTHONPATH", "/nowhere")
    findings = asyncio.run(make(python=python).check(TIMEOUT))
    assert [finding.is_well for finding in findings] == [False]
    assert remedy in findings[0].text


def test_the_adapter_is_the_watchdog_of_a_real_robot() -> None:
    assert not make().is_simulated
    assert make().zero_sender() is None
