"""Driver `ros1` with a fake adapter; needs no ROS."""

from __future__ import annotations

import asyncio
import errno
import os
import signal
import socket
import sys
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import pytest

from swarmd.core.values import Value
from swarmd.drivers.ros1 import adapter as ros1_child
from swarmd.drivers.ros1 import adapter_process as ros1_adapter
from swarmd.drivers.ros1.driver import Ros1Driver
from swarmd.settings.platforms import load_platform
from swarmd.testing.driver_contract import TIMEOUT, CollectingSink, is_running
from tests.support.stories import Tell, Test, as_test

FAKE_ADAPTER = Path(__file__).with_name("fake_adapter.py")
PLATFORM = load_platform("burger")


def make(**options: Value) -> Ros1Driver:
    return Ros1Driver(swarm="s", robot="r", platform=PLATFORM, options=options)


def playing(kind: str) -> Callable[[Tell], Test]:
    """A test of a story with an adapter of that kind; it takes `driver`, `sink` and fixtures."""

    async def played(told: Tell) -> None:
        driver, sink = make(python=sys.executable), CollectingSink()
        task = asyncio.create_task(driver.run(sink))
        try:
            async with asyncio.timeout(TIMEOUT):
                await told(driver=driver, sink=sink)
        finally:
            pid = driver.adapter_pid
            task.cancel()
            await asyncio.gather(task, return_exceptions=True)
            assert pid is None or not is_running(pid)

    def of(tell: Tell) -> Test:
        def run(told: Tell, given: Mapping[str, Any]) -> None:
            given["monkeypatch"].setattr(ros1_adapter, "__file__", str(FAKE_ADAPTER))
            given["monkeypatch"].setenv("FAKE_ADAPTER", kind)
            asyncio.run(played(told))

        return as_test(tell, run, ("driver", "sink"), ("monkeypatch",))

    return of


async def until(condition: Callable[[], bool]) -> None:
    while not condition():
        await asyncio.sleep(0.01)


def texts(sink: CollectingSink) -> list[str]:
    return [text for _, text in sink.states]


@pytest.mark.integration
@playing("garbage")
async def test_garbage_is_counted_and_later_events_are_read(sink: CollectingSink) -> None:
    await until(lambda: any("a fake adapter" in text for text in texts(sink)))
    assert sink.lost.count("ros1/garbage") >= 60
    assert not sink.is_up
    assert not sink.scans


@pytest.mark.integration
@playing("dies")
async def test_the_last_words_of_an_adapter_are_reported(sink: CollectingSink) -> None:
    await until(lambda: any("it cannot go on" in text for text in texts(sink)))


@pytest.mark.integration
@playing("mute")
async def test_a_silent_adapter_is_killed(
    sink: CollectingSink, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(ros1_child, "START_TIMEOUT", 0.3)
    await until(lambda: any("SIGKILL" in text for text in texts(sink)))
    assert any("did not answer" in text for text in texts(sink))


@pytest.mark.integration
@playing("deaf")
async def test_an_adapter_that_does_not_leave_is_killed(
    driver: Ros1Driver, sink: CollectingSink
) -> None:
    await until(lambda: any("a fake adapter" in text for text in texts(sink)))
    assert driver.adapter_pid is not None  # `playing` sees that it has ended


@pytest.mark.integration
@playing("mute")
async def test_a_full_machine_ends_no_daemon(
    driver: Ros1Driver, sink: CollectingSink, monkeypatch: pytest.MonkeyPatch
) -> None:
    def refuse(*_: object) -> None:
        raise OSError(errno.EMFILE, "Too many open files")

    await until(lambda: driver.adapter_pid is not None)
    with monkeypatch.context() as full:
        full.setattr(socket, "socketpair", refuse)
        os.kill(driver.adapter_pid or 0, signal.SIGKILL)
        await until(lambda: any("is the machine full?" in text for text in texts(sink)))
    await until(lambda: driver.adapter_pid is not None)


@pytest.mark.integration
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
