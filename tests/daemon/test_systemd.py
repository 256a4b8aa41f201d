"""What the daemon tells systemd."""

from __future__ import annotations

import socket
from pathlib import Path

import pytest

from swarmd.daemon.systemd import Notifier


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
