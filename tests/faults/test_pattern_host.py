"""Patterns that fail, or are stopped while they load: the robot stops and the daemon lives."""

from __future__ import annotations

import os
import re
import signal
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from itertools import pairwise
from typing import TYPE_CHECKING, Literal

import pytest

from swarmd.core.clock import boottime
from swarmd.core.codec import Decoder, encode
from swarmd.core.messages import Code, Reason, State
from swarmd.core.refusal import Refusal
from swarmd.core.verbs import LogBatch, LogsQuery
from swarmd.robot.timeouts import FIRST_BACKOFF
from swarmd.testing.driver_contract import is_running
from tests.faults.conftest import ROBOT
from tests.support.forked_fleet_daemon import EXECUTED_HOSTS
from tests.support.processes import wait_until

if TYPE_CHECKING:
    from tests.faults.conftest import Bench

pytestmark = pytest.mark.integration


@pytest.fixture(autouse=True, scope="module")
def executed_hosts() -> Iterator[None]:
    """Hosts start from nothing, as those of users."""
    with pytest.MonkeyPatch.context() as here:
        here.setenv(EXECUTED_HOSTS, "1")
        yield


def test_a_killed_host_stops_the_robot_and_its_pattern_restarts(robot: Bench) -> None:
    instance, pids = robot.status().epoch.instance, list[int]()

    def kill() -> float:
        pids.append(robot.daemon.host_pid())
        now = boottime()
        os.kill(pids[-1], signal.SIGKILL)
        return now

    back = robot.drive_until_restarted("drive", kill)
    robot.await_event("drive failed: its process was killed by SIGKILL", back.began)
    robot.await_reason(Reason.PATTERN_RESTARTING, back.began)
    zero = robot.body.wait_zero(back.began)
    again = robot.body.wait_moving(zero.at)
    print(
        f"zero after {zero.at - back.began:.4f} s, moving again after {again.at - back.began:.3f} s"
    )
    assert again.at - back.began > FIRST_BACKOFF
    assert robot.daemon.host_pid() not in pids
    robot.lives(instance)


def test_the_command_of_a_frozen_host_expires_and_the_host_is_replaced(robot: Bench) -> None:
    instance, pids = robot.status().epoch.instance, list[int]()

    def stop() -> float:
        pids.append(robot.daemon.host_pid())
        now = boottime()
        os.kill(pids[-1], signal.SIGSTOP)
        return now

    back = robot.drive_until_restarted("drive", stop)
    expired = robot.await_reason(Reason.COMMAND_EXPIRED, back.began)
    assert expired.status.state is State.RUNNING
    robot.await_event("drive failed: gave no answer for 1 s", back.began)
    zero = robot.body.wait_zero(back.began)
    again = robot.body.wait_moving(zero.at)
    print(
        f"zero after {zero.at - back.began:.3f} s, moving again after {again.at - back.began:.3f} s"
    )
    assert expired.at < back.failed.at < again.at
    wait_until(lambda: not any(is_running(pid) for pid in pids), "the stopped host is gone")
    robot.lives(instance)


def test_an_endless_loop_stops_the_robot_and_not_the_daemon(robot: Bench) -> None:
    before = robot.status()
    back = robot.drive_until_restarted("looper")
    robot.await_reason(Reason.COMMAND_EXPIRED, back.began)
    assert robot.status().epoch.instance == before.epoch.instance
    robot.await_event("looper failed: gave no answer for 1 s", back.began)
    killed = back.failed.at
    hung = [one for one in robot.body.commands if killed - 0.5 < one.at < killed]
    print(f"killed {killed - back.began:.3f} s after it began; {len(hung)} zeros in 0.5 s before")
    if not robot.body.was_late(back.began):  # else commands have the times of their late reading
        assert hung
        assert all(command.twist.is_zero for command in hung)
    robot.lives(before.epoch.instance)


def test_an_operator_can_stop_a_hanging_pattern_and_run_another(robot: Bench) -> None:
    moving = robot.drive("looper")
    robot.body.wait_zero(moving.at)  # hangs since 0.3 s

    stopped = boottime()
    robot.halt("stop")
    print(f"acked after {boottime() - stopped:.3f} s")
    robot.await_state(State.STOPPED, Reason.OPERATOR, stopped)
    moving = robot.drive()
    print(f"another drives {moving.at - stopped:.3f} s after the stop")
    assert robot.status().pattern == "drive"


def test_a_pattern_that_keeps_raising_backs_off_then_is_quarantined(robot: Bench) -> None:
    instance = robot.status().epoch.instance
    _, end = robot.drive_to_quarantine("raiser")
    assert (end.status.state, end.status.reason) == (State.FAULTED, Reason.QUARANTINED)
    assert "raiser failed 4 times" in end.status.detail
    assert "ZeroDivisionError" in end.status.detail
    assert "(raiser.py:" in end.status.detail

    events = [event for event in end.status.events if event.text.startswith("raiser ")][-7:]
    words = [event.text.split()[1].rstrip(":") for event in events]
    assert words == ["failed", "restarted"] * 3 + ["failed"]
    pauses = [b.at - a.at for a, b in pairwise(events)][0::2]
    print("restarted after", ", ".join(f"{pause:.3f} s" for pause in pauses))
    assert all(pause > FIRST_BACKOFF * 2**n for n, pause in enumerate(pauses))

    zero = robot.body.wait_zero(end.at)
    refused = robot.run("drive")
    assert refused.refusal is Refusal.FAULTED
    assert "raiser failed 4 times" in refused.text
    robot.moves_not(zero.at)
    robot.lives(instance)
    assert robot.ask("reset").code is Code.APPLIED
    robot.moves_not(zero.at)
    robot.drive()


@pytest.mark.parametrize(
    ("pattern", "why"),
    [
        ("hoarder", "its process needed more memory than it may have"),
        ("babbler", "the pattern host sent an unreadable frame"),
    ],
)
def test_a_pattern_that_keeps_ending_its_host_is_quarantined(
    robot: Bench, pattern: str, why: str
) -> None:
    instance = robot.status().epoch.instance
    moving, end = robot.drive_to_quarantine(pattern)
    assert (end.status.state, end.status.reason) == (State.FAULTED, Reason.QUARANTINED)
    zero = robot.body.wait_zero(moving.at)
    robot.await_event(f"{pattern} failed: {why}", moving.at)
    print(f"zero after {zero.at - moving.at:.3f} s, quarantined after {end.at - moving.at:.3f} s")
    assert why in end.status.detail
    robot.moves_not(robot.body.wait_zero(end.at).at)
    robot.lives(instance)


def test_a_pattern_that_floods_the_daemon_does_not_block_it(robot: Bench) -> None:
    moving = robot.drive("flooder")
    instance = robot.status().epoch.instance
    robot.body.wait(lambda command: command.scan_seq > moving.scan_seq + 5, moving.at)
    status = robot.status()
    assert (status.state, status.pattern) == (State.RUNNING, "flooder")
    print(f"ticks were {1e3 * status.health.loop_p99:.1f} ms late (p99)")
    flooded = boottime()
    robot.halt("stop")
    acked = boottime()  # a late decision has given zero before, too
    print(f"stop acked after {acked - flooded:.3f} s")
    robot.moves_not(robot.body.wait_zero(acked).at)
    robot.lives(instance)


def test_a_child_of_an_ended_pattern_is_killed_and_hides_nothing(robot: Bench) -> None:
    instance = robot.status().epoch.instance
    back = robot.drive_until_restarted("forker")
    robot.await_event("forker failed: its process ended with code 3", back.began)
    zero = robot.body.wait_zero(back.began)
    again = robot.body.wait_moving(zero.at)
    print(f"zero after {zero.at - back.began:.3f} s, moving {again.at - zero.at:.3f} s later")
    left = [int(pid) for pid in re.findall(r"left a child: (\d+)", robot.daemon.text())]
    assert left
    wait_until(lambda: not any(is_running(pid) for pid in left), "the children are gone")
    robot.lives(instance)


def test_output_of_a_pattern_goes_to_the_log(robot: Bench) -> None:
    moving = robot.drive("talker")
    robot.body.wait(lambda command: command.scan_seq > moving.scan_seq + 5, moving.at)
    status = robot.status()
    assert status.state is State.RUNNING
    assert not any("talker failed" in event.text for event in status.events)
    wait_until(lambda: "hello from a pattern" in robot.daemon.text(), "it is in the log")
    answer = robot.operator.ask(ROBOT, "logs", encode(LogsQuery(grep="hello")), timeout=10.0)
    assert answer is not None
    assert {one.source for one in Decoder(LogBatch)(answer).records} == {"pattern"}
    assert robot.daemon.out.read_bytes() == b""


def test_an_endless_import_stops_a_driving_robot_and_is_given_up(robot: Bench) -> None:
    moving = robot.drive()
    instance = robot.status().epoch.instance

    asked = boottime()
    reply = robot.run("endless_import")
    print(f"given up after {boottime() - asked:.3f} s")
    assert (reply.code, reply.refusal) == (Code.FAILED, Refusal.PATTERN_FAILED)
    assert "loading took more than 3 s" in reply.text
    stopped = robot.await_state(State.STOPPED, Reason.LOAD_FAILED, moving.at)
    zero = robot.body.wait_zero(stopped.at)
    robot.moves_not(zero.at)
    robot.lives(instance)
    robot.drive()


def test_an_endless_import_leaves_an_idle_robot_idle(robot: Bench) -> None:
    asked = boottime()
    before = robot.status()
    reply = robot.run("endless_import")
    assert (reply.code, reply.refusal) == (Code.FAILED, Refusal.PATTERN_FAILED)
    status = robot.status()
    assert (status.state, status.reason) == (before.state, before.reason)
    assert any("endless_import was not loaded" in event.text for event in status.events)
    robot.moves_not(asked)


@pytest.mark.parametrize(
    ("verb", "state", "reason", "is_driving"),
    [
        ("stop", State.STOPPED, Reason.OPERATOR, True),
        ("estop", State.ESTOPPED, Reason.ESTOP, False),
    ],
)
def test_a_stop_while_a_pattern_is_loaded_cancels_the_load(
    robot: Bench, verb: Literal["stop", "estop"], state: State, reason: Reason, is_driving: bool
) -> None:
    if is_driving:
        robot.drive()
    epoch = robot.status().epoch
    with ThreadPoolExecutor() as pool:
        asked = boottime()
        run = pool.submit(robot.ask, "run", epoch=epoch, pattern="slow_import", params={})
        robot.witness.wait("loading", lambda status: status.detail == "loading slow_import", asked)
        halted = boottime()
        ack = robot.halt(verb)
        print(f"{verb} acked after {boottime() - halted:.3f} s: {ack.text}")
        reply = run.result()
    print(f"run answered after {boottime() - asked:.3f} s: {reply.text}")
    assert reply.refusal is Refusal.OVERTAKEN
    assert reply.text.startswith(f"{reason} while it was being loaded")

    stopped = robot.await_state(state, reason, halted)
    zero = robot.body.wait_zero(stopped.at)
    robot.moves_not(zero.at, scans=8)  # longer than the import would have taken
    status = robot.status()
    assert (status.state, status.reason) == (state, reason)


def test_a_pattern_that_imports_for_a_second_is_loaded_and_drives(robot: Bench) -> None:
    moving = robot.drive()
    asked = boottime()
    robot.drive("slow_import")
    zero = robot.body.wait_zero(asked)
    again = robot.body.wait_moving(zero.at)
    print(f"stood {again.at - zero.at:.3f} s between the two patterns")
    assert moving.at < zero.at
    assert robot.status().pattern == "slow_import"
