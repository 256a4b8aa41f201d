"""What the daemon tells systemd."""

from __future__ import annotations

import logging
import os
import socket
from pathlib import Path

import pytest

from swarmd.core.events import TICK_INPUT, OdometryInput
from swarmd.core.values import ZERO, Odometry, Pose
from swarmd.daemon.systemd import DECISION_TIMEOUT, JournalFormatter, Notifier, is_journal
from tests.support.robot_harness import RobotHarness


def test_the_state_and_the_status_reach_systemd(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as systemd:
        systemd.bind(str(tmp_path / "notify"))
        monkeypatch.setenv("NOTIFY_SOCKET", str(tmp_path / "notify"))
        notify = Notifier()
        notify("READY=1")
        notify.status("wlan0: no address yet\nREADY=1")
        assert systemd.recv(100) == b"READY=1"
        assert systemd.recv(100) == b"STATUS=wlan0: no address yet READY=1"


def test_nothing_happens_without_systemd(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("NOTIFY_SOCKET", raising=False)
    Notifier()("READY=1")
    monkeypatch.setenv("NOTIFY_SOCKET", "/nowhere/at/all")
    Notifier().status("wlan0: absent")


def test_a_robot_that_does_not_decide_does_not_feed_the_watchdog(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    harness = RobotHarness()
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM | socket.SOCK_NONBLOCK) as systemd:
        systemd.bind(str(tmp_path / "notify"))
        monkeypatch.setenv("NOTIFY_SOCKET", str(tmp_path / "notify"))
        monkeypatch.setenv("WATCHDOG_USEC", "5000000")
        notify = Notifier()
        harness.advance(1.0)
        notify.feed_watchdog(harness.robot.decided_at, harness.now)
        assert systemd.recv(100) == b"WATCHDOG=1"
        decided_at = harness.robot.decided_at
        late = decided_at + DECISION_TIMEOUT + 0.01
        harness.robot.step(
            OdometryInput(Odometry(late, Pose(), ZERO)), late
        )  # an input, no decision
        notify.feed_watchdog(harness.robot.decided_at, late)
        with pytest.raises(BlockingIOError):
            systemd.recv(100)
        harness.robot.step(TICK_INPUT, late)
        notify.feed_watchdog(harness.robot.decided_at, late)
        assert systemd.recv(100) == b"WATCHDOG=1"


@pytest.mark.parametrize("is_watched", [True, False])
def test_the_watchdog_is_fed_if_systemd_has_one(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, is_watched: bool
) -> None:
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM | socket.SOCK_NONBLOCK) as systemd:
        systemd.bind(str(tmp_path / "notify"))
        monkeypatch.setenv("NOTIFY_SOCKET", str(tmp_path / "notify"))
        monkeypatch.delenv("WATCHDOG_USEC", raising=False)
        if is_watched:
            monkeypatch.setenv("WATCHDOG_USEC", "5000000")
        notify = Notifier()
        notify.feed_watchdog(10.0, 10.0)
        notify("READY=1")
        assert systemd.recv(100) == (b"WATCHDOG=1" if is_watched else b"READY=1")


def test_the_journal_is_known_by_its_device_and_inode(tmp_path: Path) -> None:
    with (tmp_path / "log").open("w") as stream, (tmp_path / "other").open("w") as other:
        found = os.fstat(stream.fileno())
        environ = {"JOURNAL_STREAM": f"{found.st_dev}:{found.st_ino}"}
        assert is_journal(stream, environ)
        assert not is_journal(other, environ)
        assert not is_journal(stream, {})
    assert not is_journal(stream, environ), "closed"


def test_each_line_for_the_journal_has_its_level() -> None:
    record = logging.makeLogRecord({"levelno": logging.WARNING, "msg": "one\ntwo"})
    assert JournalFormatter("%(message)s").format(record) == "<4>one\n<4>two"
