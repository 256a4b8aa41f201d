"""A daemon killed and frozen, its base without a timeout, and the watchdog between them."""

from __future__ import annotations

import asyncio
import contextlib
import os
import signal
import subprocess
import time
from itertools import pairwise, takewhile
from typing import TYPE_CHECKING

import pytest

from swarmd.core.clock import boottime
from swarmd.core.messages import Code, Reason, State
from swarmd.driver_api.driver import ZeroSenderSpec
from swarmd.driver_api.watchdog import MIN_ZERO_TIME
from swarmd.driver_api.watchdog_client import WatchdogProcess
from swarmd.drivers.simulated import SimulatedDriver
from swarmd.testing.driver_contract import is_running
from tests.support.fake_body import Commanded
from tests.support.processes import attempts, wait_until, watchdogs

if TYPE_CHECKING:
    from tests.faults.conftest import Bench

pytestmark = pytest.mark.integration

WITHIN = 0.6
"""Seconds within which a base without a timeout is told to stand; on a starved machine later."""
SLACK = 4.0
SILENT = "the daemon is silent: sending zeros"


@pytest.fixture
def guarded(bench: Bench) -> Bench:
    """A robot whose base keeps its last command for ever; its daemon is ready."""
    bench.driver_options = {"command_timeout": "none"}
    bench.start()
    return bench


def watchdog_of(bench: Bench) -> int:
    (pid,) = watchdogs(bench.swarm, bench.body.robot)
    return pid


def zeros_since(bench: Bench, since: float) -> list[Commanded]:
    return [one for one in bench.body.commands if one.at > since and one.twist.is_zero]


def is_of_watchdog(command: Commanded) -> bool:
    """Whether a watchdog sent it: a daemon names its last scan, but in the zero for a lost base."""
    return command.scan_seq < 0


def await_last_zero(bench: Bench, after: float) -> None:
    """A zero of the watchdog came after this time; the body may read it later than it ended."""
    bench.body.wait(is_of_watchdog, after)


def drives_undisturbed(bench: Bench, since: float) -> None:
    """No watchdog sends zero for a second in which neither the daemon nor the base stands still."""
    for _ in attempts("neither the daemon nor the base stands still for a second"):
        silences = bench.daemon.text().count(SILENT)
        bench.body.wait(lambda one: one.at > since + 1.0)  # noqa: B023
        zeros = [one for one in zeros_since(bench, since) if is_of_watchdog(one)]
        if bench.daemon.text().count(SILENT) == silences and not bench.body.was_late(since):
            assert not zeros, "no other process sends zero"
            return
        since = bench.drive().at + MIN_ZERO_TIME  # the stall may have ended the run


def await_steady_zeros(bench: Bench, since: float, seconds: float) -> float:
    """Wait for `seconds` of zeros alone; seconds from `since` to the first of these."""
    zeros: list[float] = []

    def are_steady() -> bool:
        after = [one for one in bench.body.commands if one.at > since]
        zeros[:] = [one.at for one in takewhile(lambda one: one.twist.is_zero, reversed(after))]
        return bool(zeros) and zeros[0] - zeros[-1] > seconds

    wait_until(are_steady, "zeros for long enough")
    assert max(later - at for later, at in pairwise(zeros)) < SLACK
    return zeros[-1] - since


def test_a_killed_daemon_leaves_a_watchdog_that_stops_the_base(guarded: Bench) -> None:
    guarded.drive()
    watchdog = watchdog_of(guarded)
    killed = boottime()
    guarded.daemon.kill()
    assert await_steady_zeros(guarded, killed, 3.0) < WITHIN + SLACK
    assert is_running(watchdog), "it sends until the daemon is back"


def test_a_daemon_that_is_back_relieves_the_watchdog_of_the_one_before(guarded: Bench) -> None:
    guarded.drive()
    before = watchdog_of(guarded)
    guarded.daemon.kill()
    guarded.start()
    moving = guarded.drive()  # at once: the last zero has been said
    wait_until(lambda: not is_running(before), "the first watchdog has ended")
    assert watchdog_of(guarded) != before
    drives_undisturbed(guarded, moving.at)


def test_signals_meant_for_everyone_leave_the_watchdog_at_its_post(guarded: Bench) -> None:
    guarded.drive()
    watchdog = watchdog_of(guarded)
    assert os.getsid(watchdog) != os.getsid(guarded.daemon.process.pid), "Ctrl-C"
    for number in (signal.SIGINT, signal.SIGHUP, signal.SIGTERM, signal.SIGABRT):
        os.kill(watchdog, number)
    signalled = boottime()
    drives_undisturbed(guarded, signalled)
    assert is_running(watchdog)
    killed = boottime()
    guarded.daemon.kill()
    guarded.body.wait_zero(killed)
    wait_until(lambda: not is_running(watchdog), "it was asked to end, and has")
    await_last_zero(guarded, killed + 1.5)


def test_a_frozen_daemon_is_stopped_for_and_thawed_it_does_not_move(guarded: Bench) -> None:
    drives_undisturbed(guarded, guarded.drive().at)
    watchdog = watchdog_of(guarded)
    frozen = boottime()
    guarded.daemon.freeze()
    try:
        after = await_steady_zeros(guarded, frozen, 3.0)
    finally:
        thawed = boottime()
        guarded.daemon.thaw()
    assert after < WITHIN + SLACK  # and not before 0.4 s: tests/driver_api/test_watchdog.py
    stalled = guarded.await_state(State.STOPPED, Reason.LOOP_STALLED, thawed)
    assert not guarded.body.moved_since(stalled.at)
    assert watchdog_of(guarded) == watchdog, "it is the same, and serves on"
    guarded.meet()
    moving = guarded.drive()
    guarded.body.wait(lambda one: one.at > moving.at + 0.5)
    wait_until(lambda: guarded.body.commands[-1].twist.linear > 0.0, "it drives on undisturbed")


def test_a_daemon_that_is_back_before_the_zeros_end_requires_zero_too(guarded: Bench) -> None:
    for _ in attempts("this process measures without a stall of its own"):
        guarded.drive()
        frozen = boottime()
        guarded.daemon.freeze()
        try:
            first = guarded.body.wait(is_of_watchdog, frozen)
        finally:
            guarded.daemon.thaw()
        guarded.body.wait(lambda one: one.at > first.at + MIN_ZERO_TIME + 0.5)  # noqa: B023
        if not guarded.body.was_late(frozen):
            break
        guarded.calm()
    meanwhile = [
        one for one in guarded.body.commands if 0.0 < one.at - first.at < MIN_ZERO_TIME - 0.1
    ]
    moving = [one for one in meanwhile if not one.twist.is_zero]
    # On their way when the daemon froze: the command for a scan and that for the pattern's answer.
    assert len(moving) <= 2
    assert len({one.scan_seq for one in moving}) <= 1
    wait_until(lambda: not guarded.body.commands[-1].twist.is_zero, "it drives on")


def test_asked_to_end_the_watchdog_sends_zeros_for_2_s_and_ends(guarded: Bench) -> None:
    guarded.drive()
    watchdog = watchdog_of(guarded)
    asked = boottime()
    assert guarded.daemon.terminate() == 0
    ended = boottime()
    wait_until(lambda: not is_running(watchdog), "its watchdog is gone")
    gone = boottime()
    await_last_zero(guarded, asked + 1.5)
    assert not guarded.body.moved_anew(ended)
    assert gone - ended < 10.0


@pytest.mark.parametrize("number", [signal.SIGKILL, signal.SIGSTOP])
def test_without_its_watchdog_the_robot_is_held_until_a_new_one_runs(
    guarded: Bench, number: signal.Signals
) -> None:
    guarded.drive()
    watchdog = watchdog_of(guarded)
    harmed = boottime()
    os.kill(watchdog, number)
    try:
        guarded.body.wait_zero(harmed)
        lost = guarded.await_event("driver: the watchdog ", harmed)
        guarded.witness.wait("up again", lambda status: status.health.driver_up, lost.at)
        wait_until(lambda: guarded.run("drive").code is Code.APPLIED, "it can be run again")
        guarded.body.wait_moving(lost.at)
        assert watchdog_of(guarded) != watchdog
    finally:
        with contextlib.suppress(ProcessLookupError):
            os.kill(watchdog, signal.SIGKILL)


def test_a_silent_daemon_leaves_an_idle_robot_alone_and_no_other(bench: Bench) -> None:
    bench.driver_options = {"command_timeout": 0.5, "idle_output": "silent"}
    bench.start()
    commands = bench.body.commands
    wait_until(lambda: bool(commands), "its first zeros")
    wait_until(lambda: boottime() - commands[-1].at > 1.0, "then nothing more")
    assert all(one.twist.is_zero for one in commands)
    bench.drive()
    bench.halt("stop")
    stopped = bench.body.wait_zero(boottime())
    wait_until(lambda: commands[-1].at - stopped.at > 2.0, "who is stopped is told zero")
    assert not bench.body.moved_since(stopped.at)
    assert not watchdogs(bench.swarm, bench.body.robot), "a base with a timeout needs none"


def test_what_it_is_tied_to_ends_it_although_its_daemon_never_returns() -> None:
    where = {"swarm": "s", "robot": "r", "endpoint": "tcp/127.0.0.1:9"}
    spec = ZeroSenderSpec(SimulatedDriver.__module__ + ":SimulatedZeroSender", where)
    parent = subprocess.Popen(["sleep", "600"])

    async def leave_without_a_word() -> int:
        watchdog = WatchdogProcess(spec, name=None, tie=parent.pid)
        await watchdog.start()
        watchdog.feed()
        watchdog.hang_up()
        return watchdog.pid

    try:
        pid = asyncio.run(leave_without_a_word())
        time.sleep(MIN_ZERO_TIME + 0.5)
        assert is_running(pid)
    finally:
        parent.kill()
        parent.wait()
    wait_until(lambda: not is_running(pid), "it has ended with its parent")
