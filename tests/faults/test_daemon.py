"""A daemon that is killed, frozen, restarted or terminated, and the latch that outlives it."""

from __future__ import annotations

import socket
import time
from pathlib import Path
from typing import TYPE_CHECKING

import pytest

from swarmd.core.clock import boottime
from swarmd.core.messages import Code, Reason, State
from swarmd.core.refusal import Refusal
from swarmd.core.verbs import RunRequest
from swarmd.link.datagram import STATES, Flag
from swarmd.testing.driver_contract import is_running
from tests.faults.conftest import ROBOT
from tests.support.processes import wait_until

if TYPE_CHECKING:
    from tests.faults.conftest import Bench

pytestmark = pytest.mark.integration

QUIET = 0.5  # ten ticks without a command


def await_silence(bench: Bench) -> float:
    """When the last command arrived, once none has followed for half a second."""
    commands = bench.body.commands
    wait_until(lambda: boottime() - commands[-1].at > QUIET, "the commands end")
    return commands[-1].at


def freeze_while_held(bench: Bench) -> float:
    """Freeze the daemon of a robot that runs but is held, and end what held it; when that was.

    It would move with the next scan. A command that moves may not be on its way out just then:
    the network would send it on at the thaw.
    """
    now = boottime()
    bench.body.scans = lambda seq, stamp: None
    held = bench.await_reason(Reason.STALE_SCAN, now)
    zero = bench.body.wait_zero(held.at)
    bench.daemon.freeze()
    stat = Path(f"/proc/{bench.daemon.process.pid}/stat")
    wait_until(lambda: stat.read_text().rpartition(")")[2].split()[0] == "T", "frozen")
    bench.body.scans = bench.body.clear
    assert held.status.state is State.RUNNING
    assert not bench.body.moved_since(zero.at)
    return boottime()


def test_a_killed_daemon_takes_its_host_along_and_returns_idle(bench: Bench) -> None:
    bench.start()
    bench.drive()
    before, host = bench.status(), bench.daemon.host_pid()

    killed = boottime()
    bench.daemon.kill()
    wait_until(lambda: not is_running(host), "its pattern host is gone")
    print(f"its host was gone after {boottime() - killed:.3f} s at most")
    last = await_silence(bench)
    print(f"its last command came {1e3 * (last - killed):.1f} ms after it was killed")

    begun = bench.start()
    after = bench.status()
    assert (after.state, after.reason) == (State.IDLE, Reason.NEVER_ASKED)
    assert after.instance != before.instance
    late = bench.ask("run", epoch=before.epoch, pattern="drive", params={})
    assert late.refusal is Refusal.STALE_EPOCH
    assert "changed since you looked" in late.text
    bench.moves_not(begun)
    bench.drive()


def test_a_killed_daemon_takes_even_a_host_along_that_hangs(bench: Bench) -> None:
    bench.start()
    moving = bench.drive("looper")
    host = bench.daemon.host_pid()
    bench.await_reason(Reason.COMMAND_EXPIRED, moving.at)
    assert is_running(host)
    bench.daemon.kill()
    wait_until(lambda: not is_running(host), "its pattern host is gone")


@pytest.mark.parametrize(
    "seconds", [3.0, *(pytest.param(s, marks=pytest.mark.evidence) for s in (1.0, 6.0, 10.0))]
)
def test_nothing_that_waited_for_a_frozen_daemon_moves_its_body(
    bench: Bench, seconds: float
) -> None:
    bench.start()
    bench.drive()
    seen = bench.status().epoch

    frozen = freeze_while_held(bench)
    asked = bench.operator.request(
        RunRequest,
        {bench.body.robot: seen},
        pattern="drive",
        params={"speed": -0.1},
        timeout=0.3,
    )
    stopped = bench.operator.send_stop("estop", reason="it does not answer", timeout=0.3)
    assert asked.missing == stopped.missing == (bench.body.robot,)
    wait_until(lambda: boottime() - frozen >= seconds, "long enough")

    thawed = boottime()
    bench.daemon.thaw()
    first = bench.body.wait_zero(thawed)
    bench.moves_not(frozen, scans=8)
    status = bench.status()
    bench.meet()
    met = boottime()
    print(
        f"frozen for {thawed - frozen:.2f} s, zero {1e3 * (first.at - thawed):.1f} ms after the"
        f" thaw, met again within {met - thawed:.1f} s:"
        f" {status.state} ({status.reason}) {status.detail}"
    )
    assert (status.state, status.reason) in (
        (State.STOPPED, Reason.LOOP_STALLED),
        (State.ESTOPPED, Reason.ESTOP),
    )
    assert any("loop_stalled" in event.text for event in status.events)
    assert status.epoch.revision > seen.revision
    assert status.pattern is None
    late = bench.ask("run", epoch=seen, pattern="drive", params={})
    assert late.refusal is Refusal.STALE_EPOCH


def test_an_estopped_daemon_that_is_killed_returns_estopped_until_reset(
    bench: Bench,
) -> None:
    bench.start()
    bench.drive()
    bench.halt("estop")
    zero = bench.body.wait_zero(boottime())
    held = set(bench.status().latches)
    bench.daemon.kill()

    begun = bench.start()
    status = bench.status()
    assert (status.state, status.reason) == (State.ESTOPPED, Reason.ESTOP)
    assert set(status.latches) == held
    assert "by zoe@test: test" in status.detail
    refused = bench.run("drive")
    assert refused.refusal is Refusal.ESTOPPED
    assert "reset it first" in refused.text
    bench.moves_not(zero.at)

    assert bench.ask("reset", ids=sorted(held)).code is Code.APPLIED
    bench.moves_not(begun)
    bench.drive()
    bench.daemon.kill()
    bench.start()
    assert bench.status().state is State.IDLE


def test_an_unreadable_latch_file_holds_the_robot_until_reset(bench: Bench) -> None:
    bench.state.mkdir(parents=True)
    (bench.state / "latches").write_bytes(b"\x01\x93 not a latch record")
    begun = bench.start()
    status = bench.status()
    assert (status.state, status.reason) == (State.ESTOPPED, Reason.ESTOP)
    assert "latches could not be read" in status.detail
    assert "estopped until reset" in bench.daemon.text()
    refused = bench.run("drive")
    assert refused.refusal is Refusal.ESTOPPED
    bench.moves_not(begun)
    assert bench.ask("reset", ids=list(status.latches)).code is Code.APPLIED
    bench.drive()


def test_an_estop_that_cannot_be_written_down_latches_all_the_same(bench: Bench) -> None:
    (bench.state / ".latches.partial").mkdir(parents=True)  # where it would be written first
    bench.start()
    moving = bench.drive()
    ack = bench.halt("estop")
    zero = bench.body.wait_zero(moving.at)
    assert ack.text.startswith("commanded zero")
    assert bench.status().state is State.ESTOPPED
    wait_until(lambda: "latched in memory only" in bench.daemon.text(), "it tells in its log")
    assert bench.run("drive").refusal is Refusal.ESTOPPED
    bench.moves_not(zero.at)


def test_sigterm_sends_zero_reports_left_and_exits_with_0(bench: Bench) -> None:
    bench.start()
    bench.drive()
    host = bench.daemon.host_pid()

    asked = boottime()
    code = bench.daemon.terminate()
    beacons = bench.witness.viewer.beacons
    wait_until(lambda: bool(beacons[ROBOT].flags & Flag.LEFT), "its last beacon says that it left")
    last = await_silence(bench)
    print(f"last command after {last - asked:.3f} s")
    assert code == 0
    assert STATES[beacons[ROBOT].state] is State.STOPPED
    zero = bench.body.wait_zero(asked)
    assert not bench.body.moved_since(zero.at)
    assert bench.body.commands[-1].twist.is_zero
    wait_until(lambda: not is_running(host), "its pattern host is gone")
    assert "Traceback" not in bench.daemon.text()


def test_systemd_is_notified_of_ready_alive_and_stopping_and_of_nothing_while_it_is_frozen(
    bench: Bench, tmp_path: Path
) -> None:
    path = str(tmp_path / "notify")
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as systemd:
        systemd.bind(path)
        systemd.settimeout(30.0)
        begun = time.monotonic()
        bench.start({"NOTIFY_SOCKET": path, "WATCHDOG_USEC": "2000000"})
        said = [systemd.recv(100)]
        while b"READY=1" not in said:  # a busy machine is alive before it is ready
            said.append(systemd.recv(100))
        print(f"ready within {time.monotonic() - begun:.3f} s")
        assert set(said) <= {b"READY=1", b"WATCHDOG=1"}
        assert systemd.recv(100) == b"WATCHDOG=1"
        bench.daemon.freeze()
        systemd.setblocking(False)
        drain(systemd)
        systemd.settimeout(1.5)
        with pytest.raises(TimeoutError):
            systemd.recv(100)
        systemd.settimeout(30.0)
        bench.daemon.thaw()
        assert bench.daemon.terminate() == 0
        last = systemd.recv(100)
        while last == b"WATCHDOG=1":
            last = systemd.recv(100)
        assert last == b"STOPPING=1"


def drain(receiver: socket.socket) -> None:
    """Read what has been said so far."""
    try:
        while receiver.recv(100):
            pass
    except BlockingIOError:
        return
