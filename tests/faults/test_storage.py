"""Daemons without what they expect of a machine: room on the disk, a home, root, open files."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from contextlib import ExitStack
from pathlib import Path

import pytest

from swarmd.core.codec import Decoder, encode
from swarmd.core.messages import Code, State
from swarmd.core.verbs import AuditQuery, AuditReply, DoctorReply
from swarmd.link.settings import NetworkSettings
from swarmd.operator.session.operator import Operator
from tests.support.fake_body import resting_body
from tests.support.processes import DaemonProcess, unique_swarm, wait_until
from tests.support.swarmctl import heard_statuses

pytestmark = pytest.mark.integration

NOBODY = 65534
AS_NOBODY = (
    *("setpriv", f"--reuid={NOBODY}", f"--regid={NOBODY}", "--clear-groups"),
    # It may read where Python is, which may be a closed home, and write nowhere else.
    *("--inh-caps=+dac_read_search", "--ambient-caps=+dac_read_search", "--no-new-privs"),
)
needs_root = pytest.mark.skipif(
    os.geteuid() != 0 or not all(map(shutil.which, ("unshare", "mount", "setpriv"))),
    reason="needs root, unshare, mount and setpriv",
)
FILL = "dd if=/dev/zero of={0}/fill bs=1k count=900 2>/dev/null"
READ_ONLY = "mount -o remount,ro {0}"


class Rig:
    """One robot whose base rests, on a machine that lacks something."""

    def __init__(self, folder: Path, left: ExitStack) -> None:
        self.folder, self._left = folder, left
        self.swarm = unique_swarm()
        self.state = folder / "state"
        self.state.mkdir()
        self._body = left.enter_context(resting_body(self.swarm, "r1"))

    def start(self, *prefix: str) -> DaemonProcess:
        daemon = DaemonProcess(
            self.folder,
            swarm=self.swarm,
            robot="r1",
            endpoint=self._body.endpoint,
            prefix=prefix,
            environ={"HOME": str(self.folder)},
        )
        return self._left.enter_context(daemon).wait_ready()

    def on_disk(self, fault: str) -> DaemonProcess:
        """A daemon whose state is on a small disk of its own, in a mount namespace."""
        mount = f"mount -t tmpfs -o size=512k swarmd-test {self.state}"
        script = f'{mount} && {{ {fault.format(self.state)} ; exec "$@"; }}'
        return self.start("unshare", "-m", "sh", "-c", script, "sh")

    def operator(self) -> Operator:
        found = self._left.enter_context(Operator(NetworkSettings(swarm=self.swarm), name="zoe"))
        wait_until(lambda: "r1" in found.members().answered, "r1 answers")
        return found


@pytest.fixture
def rig(tmp_path: Path) -> Iterator[Rig]:
    with ExitStack() as left:
        yield Rig(tmp_path, left)


def storage(operator: Operator) -> str:
    return heard_statuses(operator, ["r1"])["r1"].health.storage


@needs_root
@pytest.mark.parametrize("fault", [FILL, READ_ONLY], ids=["full", "read-only"])
def test_a_state_folder_that_cannot_be_written_is_told_at_each_start(rig: Rig, fault: str) -> None:
    for _ in range(2):
        daemon = rig.on_disk(fault)
        operator = rig.operator()
        assert "cannot be written" in daemon.text()
        status = heard_statuses(operator, ["r1"])["r1"]
        assert str(rig.state) in status.health.storage
        assert any("cannot be written" in event.text for event in status.events)
        (reply,) = operator.send_stop("estop").replies.values()
        assert reply.code is Code.APPLIED
        assert "not on disk" in reply.text
        daemon.kill()


@needs_root
def test_a_latch_is_written_and_the_audit_log_goes_on_once_there_is_room(rig: Rig) -> None:
    daemon = rig.on_disk(FILL)
    operator = rig.operator()
    operator.send_stop("estop", reason="cable")
    wait_until(lambda: "audit log" in daemon.text(), "the audit log tells that it fails")
    state = Path(f"/proc/{daemon.process.pid}/root{rig.state}")
    (state / "fill").unlink()
    wait_until(lambda: storage(operator) == "", "the folder can be written again")
    wait_until(lambda: any(state.glob("*/r1/latches")), "the latch is written")
    operator.send_stop("stop")

    def entries() -> list[str]:
        answer = operator.ask("r1", "audit", encode(AuditQuery()), timeout=5.0)
        assert answer is not None
        return [one.verb for one in Decoder(AuditReply)(answer).entries]

    wait_until(lambda: "stop" in entries(), "the stop is in the audit log")
    assert daemon.text().count("audit.jsonl cannot be written") == 1
    assert heard_statuses(operator, ["r1"])["r1"].state is State.ESTOPPED


@needs_root
def test_a_daemon_needs_no_root_and_says_what_it_cannot_know() -> None:
    with ExitStack() as left:
        folder = Path(left.enter_context(tempfile.TemporaryDirectory()))  # tmp_path is closed
        rig = Rig(folder, left)
        for one in (folder, rig.state):
            os.chown(one, NOBODY, NOBODY)
        check_without_root(rig)


def check_without_root(rig: Rig) -> None:
    rig.start(*AS_NOBODY)
    operator = rig.operator()
    (reply,) = operator.send_stop("estop").replies.values()
    assert "not on disk" not in reply.text
    answer = operator.ask("r1", "doctor", timeout=10.0)
    assert answer is not None
    facts = Decoder(DoctorReply)(answer)
    assert facts.network.firewall == "unknown"
    assert "root" in facts.network.firewall_text
    assert facts.storage == ""


def run(name: str, *words: str, folder: Path, prefix: tuple[str, ...] = (), **environ: str) -> str:
    """The output of a command without $HOME, and its exit code."""
    kept = {key: value for key, value in os.environ.items() if key != "HOME"}
    done = subprocess.run(
        [
            *prefix,
            sys.executable,
            "-c",
            f"from swarmd.operator.cli.entry import {name}; {name}()",
            *words,
        ],
        capture_output=True,
        text=True,
        cwd=folder,
        env={**kept, "XDG_CACHE_HOME": str(folder), "SWARM": unique_swarm(), **environ},
        timeout=120,
        check=False,
    )
    return f"{done.returncode}: {done.stdout}{done.stderr}"


def test_without_a_home_a_daemon_asks_for_a_state_folder(tmp_path: Path) -> None:
    refused = run("swarmd", "--id", "r1", "--check", folder=tmp_path)
    assert refused.startswith("2: error: ")
    assert "--state-dir" in refused
    assert len(refused.splitlines()) == 1
    checked = run("swarmd", "--id", "r1", "--check", "--state-dir", "here", folder=tmp_path)
    assert " state " in checked
    assert run("swarmctl", "doctor", folder=tmp_path).startswith("0: ")


@pytest.mark.skipif(not shutil.which("prlimit"), reason="needs prlimit")
def test_with_64_open_files_a_daemon_refuses_and_swarmctl_works(tmp_path: Path) -> None:
    few = ("prlimit", "--nofile=64:64")
    words = ("--id", "r1", "--state-dir", "here")
    refused = run("swarmd", *words, folder=tmp_path, prefix=few)
    assert refused.startswith("2: error: ")
    assert "ulimit -n" in refused
    assert run("swarmctl", "doctor", folder=tmp_path, prefix=few).startswith("0: ")
