"""The last order counts, by when it was typed, clicked or called, whatever door it came by."""

from __future__ import annotations

import asyncio
import os
import re
import subprocess
import sys
import threading
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest

import swarmd
from swarmd.core.clock import boottime
from swarmd.core.messages import State
from swarmd.operator.session.members_view import MembersView
from swarmd.operator.session.operator import Operator
from swarmd.operator.view.commander import LiveCommander
from tests.support.processes import CAP, wait_until
from tests.support.swarmctl import Finished, ask_in_time

if TYPE_CHECKING:
    from tests.support.processes import DaemonProcess
    from tests.swarm.conftest import Swarm

pytestmark = pytest.mark.integration

BOTH = ("r1", "r2")
GOAL = "goal: {pattern: drive}\n"
SWARMCTL = Path(sys.executable).with_name("swarmctl")
STARTED = re.compile(r"\((run|resume) ")


class HeldLook:
    """Holds the looks of one thread at their begin, as a robot that is missing holds their end."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch) -> None:
        self.has_begun, self.may_go_on = threading.Event(), threading.Event()
        members = Operator.members

        def look(operator: Operator, **options: Any) -> MembersView:
            self.has_begun.set()
            assert self.may_go_on.wait(CAP)
            return members(operator, **options)

        monkeypatch.setattr(Operator, "members", look)


async def _by_page(swarm: Swarm) -> None:
    commander = LiveCommander(lambda: Operator(swarm.settings))
    fields = {"pattern": "drive", "targets": list(BOTH)}
    await commander.act("run", fields, lambda answer: None)


def _by_client(swarm: Swarm) -> None:
    with swarmd.connect(swarm.name) as client:
        client.run("drive")


def _apply(swarm: Swarm) -> None:
    file = swarm.folder / "swarm.yaml"
    file.write_text(f"swarm: {swarm.name}\n{GOAL}", encoding="utf-8")
    swarm.ctl_once("apply", str(file), "--yes")


DOORS: dict[str, Callable[[Swarm], Any]] = {
    "run": lambda swarm: swarm.ctl_once("run", "drive", "--all"),
    "run --at": lambda swarm: swarm.ctl_once("run", "drive", "--all", "--at", "+1s"),
    "resume": lambda swarm: swarm.ctl_once("resume", "--all"),
    "apply": _apply,
    "client": _by_client,
    "page": lambda swarm: asyncio.run(_by_page(swarm)),
}


@pytest.fixture(scope="module")
def daemons(tmp_path_factory: pytest.TempPathFactory) -> Iterator[tuple[Swarm, DaemonProcess]]:
    """Two robots, which have run once, so that they have a goal to resume; the second daemon."""
    from tests.swarm.conftest import Swarm

    swarm = Swarm(tmp_path_factory.mktemp("two"))
    try:
        _, second = [swarm.spawn(robot, swarm.resting(robot)) for robot in BOTH]
        for robot in BOTH:
            swarm.await_status(robot, "connected", lambda status: status.health.driver_up)
        assert swarm.ctl("run", "drive", "--all").code == 0
        yield swarm, second
    finally:
        swarm.close()


@pytest.fixture
def two(daemons: tuple[Swarm, DaemonProcess]) -> Swarm:
    """The swarm of the two robots."""
    return daemons[0]


@pytest.mark.parametrize("door", DOORS)
def test_a_stop_after_a_run_that_is_still_under_way_wins(
    two: Swarm, door: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The look of the run shows the robots as they are after the stop. No stop waits for it."""
    assert two.operator.send_stop("stop").exit_code == 0
    held = HeldLook(monkeypatch)
    run = threading.Thread(target=DOORS[door], args=(two,), daemon=True)
    run.start()
    assert held.has_begun.wait(CAP)
    outcome = two.operator.send_stop("stop")
    assert outcome.applied == BOTH
    assert run.is_alive()
    held.may_go_on.set()
    run.join(CAP)
    assert not run.is_alive()
    for robot in BOTH:
        status = two.status(robot)
        assert status.state is not State.RUNNING
        assert not STARTED.search(status.changed_by)


def test_a_run_after_a_stop_runs(two: Swarm) -> None:
    """From one program, without a pause: the order is known, however long the ways are."""
    with swarmd.connect(two.name) as client:
        for _ in range(3):
            assert client.stop().applied == BOTH
            outcome = client.run("drive")
            assert outcome.applied == BOTH, outcome


def test_a_run_after_a_stop_of_one_script_runs(two: Swarm) -> None:
    """The shell becomes its last command, whose process is as old as the script."""
    script = f"{SWARMCTL} stop && exec {SWARMCTL} run drive --all"
    environ = {**os.environ, **two.environ()}

    def ask() -> Finished:
        done = subprocess.run(
            ["sh", "-c", script], env=environ, capture_output=True, text=True, timeout=CAP
        )
        return Finished(done.returncode, done.stdout, done.stderr)

    assert ask_in_time(ask).outcome == (0, "2 targeted, 2 applied")


def test_a_command_after_a_stop_begins_in_a_later_clock_tick(two: Swarm) -> None:
    """A command counts from the start of its process, which Linux tells in ticks of 10 ms."""
    for _ in range(20):
        before = boottime()
        two.operator.send_stop("stop")
        assert int(boottime() * 100) > int(before * 100)


def test_a_stop_by_a_second_terminal_wins_over_a_run_that_waits_for_a_frozen_robot(
    daemons: tuple[Swarm, DaemonProcess],
) -> None:
    two, second = daemons
    wait_until(lambda: two.operator.members().answered == {*BOTH}, "both have answered")
    second.freeze()
    try:
        run = two.begin("run", "drive", "--all", user="anna")
        stopped = two.ctl_once("stop", "r1", user="ben")
        done = run.finish()
    finally:
        second.thaw()
    assert stopped.code == 0, stopped
    assert two.status("r1").state is State.STOPPED, done
