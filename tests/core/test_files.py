"""Locks of files on file systems that have none: what is refused, and what goes on without."""

from __future__ import annotations

import errno
import fcntl
import logging
import os
import stat
from pathlib import Path

import pytest

from swarmd.core.errors import ConfigError
from swarmd.core.files import lock_file
from swarmd.daemon.recording.ring import Ring
from swarmd.link.keys.authority import Authority
from swarmd.link.keys.roster import Role
from swarmd.operator.session.senders import StopOrigin
from swarmd.sim.experiments import store

NFS, LUSTRE = errno.ENOLCK, errno.ENOSYS
BUSY = errno.EWOULDBLOCK


def give(monkeypatch: pytest.MonkeyPatch, code: int, *, are_folders_locked: bool = False) -> None:
    """Let each lock end with an error, that of a folder only if `are_folders_locked` is False."""
    real = fcntl.flock

    def flock(handle: int, operation: int) -> None:
        if are_folders_locked and stat.S_ISDIR(os.fstat(handle).st_mode):
            return real(handle, operation)
        raise OSError(code, os.strerror(code))

    monkeypatch.setattr(fcntl, "flock", flock)


@pytest.mark.parametrize("code", [NFS, LUSTRE])
def test_a_file_system_without_locks_is_no_other_process(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, code: int
) -> None:
    with (tmp_path / "x").open("wb") as file:
        assert lock_file(file.fileno(), waits=False)
        give(monkeypatch, code)
        assert not lock_file(file.fileno(), waits=False)
        give(monkeypatch, BUSY)
        with pytest.raises(BlockingIOError):
            lock_file(file.fileno(), waits=False)


@pytest.mark.parametrize("code", [NFS, LUSTRE])
def test_an_experiment_goes_on_without_locks_and_says_so(
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    caplog: pytest.LogCaptureFixture,
    code: int,
) -> None:
    give(monkeypatch, code)
    with caplog.at_level(logging.WARNING), store._locked(tmp_path):
        pass
    (record,) = caplog.records
    assert str(tmp_path) in record.getMessage()


@pytest.mark.parametrize(("code", "is_other"), [(BUSY, True), (errno.EACCES, False)])
def test_another_swarmctl_is_blamed_only_if_there_is_one(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, code: int, is_other: bool
) -> None:
    give(monkeypatch, code)
    with pytest.raises(ConfigError, match=str(tmp_path)) as refused, store._locked(tmp_path):
        pass
    assert ("another swarmctl" in str(refused.value)) == is_other
    assert (os.strerror(code) in str(refused.value)) != is_other


def test_keys_change_under_the_lock_of_their_folder_or_not_at_all(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    authority = Authority.create(tmp_path / "keys", "meadow")
    give(monkeypatch, NFS, are_folders_locked=True)
    assert "r1" in authority.change(add={"r1": Role.ROBOT}).robots
    give(monkeypatch, NFS)
    with pytest.raises(ConfigError, match=str(tmp_path / "keys")) as refused:
        authority.change(add={"r2": Role.ROBOT})
    assert "no locks" in str(refused.value)
    assert "r2" not in Authority(tmp_path / "keys").roster.robots


@pytest.mark.parametrize("code", [NFS, LUSTRE, BUSY])
def test_the_black_box_names_its_file(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, code: int
) -> None:
    give(monkeypatch, code)
    with pytest.raises(OSError, match="ring") as refused:
        Ring(tmp_path / "ring", {}, capacity=4096, seconds=10.0, boot=0.0, wall=0.0)
    assert refused.value.filename == str(tmp_path / "ring")


@pytest.mark.parametrize("code", [NFS, LUSTRE, BUSY])
def test_a_stop_has_an_origin_of_its_own_without_locks(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, code: int
) -> None:
    give(monkeypatch, code)
    origin = StopOrigin(tmp_path, clock=lambda: 2.0)
    first, counter = origin.next()
    assert counter == 2000
    assert origin.next()[0] != first
