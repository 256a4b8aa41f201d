"""`swarmd hub`: the hub of a base outlives the signals that end its robot."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable

import pytest

from swarmd.testing.driver_contract import is_running
from tests.support.processes import CAP, wait_until
from tests.support.swarmctl import Running

pytestmark = pytest.mark.integration

ZEROS = 2.0
"""s for which the watchdog sends zeros after the end of a daemon (docs/robots/burger.md)."""
HUB = ("sh", "-c", "echo $$; exec sleep 600")


def hub(*command: str) -> Running:
    return Running("hub", *command, program="swarmd")


def end_all(front: Running, hub_pid: int, number: int) -> None:
    """The signal to each process, as to a process group or a control group."""
    os.kill(hub_pid, number)
    front.send_signal(number)


def kill_front(front: Running, hub_pid: int, number: int) -> None:
    front.kill()


@pytest.mark.parametrize(
    ("end", "number", "code"),
    [
        (end_all, signal.SIGINT, 0),
        (end_all, signal.SIGTERM, 0),
        (end_all, signal.SIGHUP, 0),
        (kill_front, signal.SIGKILL, None),
    ],
    ids=["Ctrl-C", "the end of a service", "hang-up", "killed by its launcher"],
)
def test_a_hub_outlives_the_zeros_of_a_robot_that_ends_with_it(
    end: Callable[[Running, int, int], None], number: int, code: int | None
) -> None:
    with hub(*HUB) as front:
        pid = int(front.out.readline())
        began = time.monotonic()
        end(front, pid, number)
        wait_until(lambda: not is_running(pid), "the hub has ended")
        assert time.monotonic() - began > ZEROS
        if code is not None:
            assert front.wait(CAP) == code


SLOW = """import os, sys, time
from swarmd.operator.cli.hub import run_hub
fork = os.fork
def slow_fork():
    pid = fork()
    time.sleep(1.0 if pid else 0.0)
    return pid
os.fork = slow_fork
sys.exit(run_hub(sys.argv[1:], outlives=0.1))
"""
"""The first process goes on 1 s after the fork, as on a busy machine."""


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM, signal.SIGHUP])
def test_a_signal_that_comes_as_the_hub_starts_is_not_lost(number: int) -> None:
    command = [sys.executable, "-c", SLOW, *HUB]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as front:
        assert front.stdout is not None
        pid = int(front.stdout.readline())
        try:
            front.send_signal(number)
            wait_until(lambda: not is_running(pid), "the hub has ended")
            assert front.wait(CAP) == 0
        finally:
            front.kill()


def test_a_hub_that_ends_by_itself_gives_its_exit_code() -> None:
    assert hub("sh", "-c", "exit 7").finish().code == 7


def test_what_a_hub_has_started_ends_with_it() -> None:
    with hub("sh", "-c", "sleep 600 & echo $!; exit 0") as front:
        pid = int(front.out.readline())
        wait_until(lambda: not is_running(pid), "its child has ended")


def test_a_program_that_is_absent_is_a_wrong_setting() -> None:
    done = hub("zenoh-bridge-of-nobody").finish()
    assert done.code == 2
    assert "zenoh-bridge-of-nobody" in done.err
