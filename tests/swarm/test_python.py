"""A swarm of real daemons from Python: the answers of swarmctl, from threads and from a loop."""

from __future__ import annotations

import asyncio
import contextlib
import itertools
import math
import os
import signal
import subprocess
import sys
import threading
from collections.abc import Awaitable, Callable, Iterator
from pathlib import Path
from typing import TYPE_CHECKING

import pytest

import swarmd
from swarmd.core.errors import ConfigError, NetworkError, RequestError, SwarmError
from swarmd.core.messages import Presence, Reason, State
from swarmd.core.refusal import Refusal
from swarmd.operator.client.hand_over import HAND_OVER
from swarmd.operator.session.exit_codes import NO_TARGET, PARTIAL, REFUSED, TIMEOUT, USAGE
from swarmd.operator.session.states import MAX_WAITING
from tests.support.processes import CAP, DaemonProcess, unique_swarm, wait_until
from tests.support.secured_swarm import SecuredSwarm
from tests.support.swarmctl import STALLED, typed_in_time

if TYPE_CHECKING:
    from swarmd.operator.client.swarm import Swarm as Client
    from swarmd.operator.session.outcome import Outcome
    from tests.swarm.conftest import Swarm

pytestmark = pytest.mark.integration
BOTH = ("r1", "r2")


@pytest.fixture(scope="module")
def daemons(shared_swarm: Swarm) -> dict[str, DaemonProcess]:
    bodies = {robot: shared_swarm.body(robot) for robot in BOTH}
    found = {robot: shared_swarm.spawn(robot, body) for robot, body in bodies.items()}
    for robot, daemon in found.items():
        daemon.wait_ready()
        shared_swarm.await_status(robot, "connected", lambda one: one.health.driver_up)
    for robot, other in (BOTH, BOTH[::-1]):
        shared_swarm.await_presence(robot, other, Presence.ALIVE)
    return found


@pytest.fixture
def name(
    shared_swarm: Swarm, daemons: dict[str, DaemonProcess], monkeypatch: pytest.MonkeyPatch
) -> Iterator[str]:
    """The swarm's name; its robots are thawed, stopped and reset at the end."""
    for key, value in shared_swarm.environ().items():
        monkeypatch.setenv(key, value)
    yield shared_swarm.name
    for daemon in daemons.values():
        daemon.thaw()
    operator = shared_swarm.operator
    assert operator.send_stop("stop", select=lambda _: (), names=BOTH).exit_code == 0
    if any(shared_swarm.status(robot).latches for robot in BOTH):
        assert shared_swarm.ctl("reset", "--all", "--yes").code == 0


@pytest.fixture
def swarm(name: str) -> Iterator[Client]:
    with swarmd.connect(timeout=10.0) as found:  # $SWARM names it
        yield found


def test_a_run_from_start_to_stop(swarm: Client) -> None:
    assert swarm.members().alive == BOTH
    assert typed_in_time(lambda: swarm.run("drive", params={"speed": 0.1})).applied == BOTH
    assert swarm.wait("state=running") == BOTH
    assert swarm.param({"speed": 0.05}, "r2").applied == ("r2",)
    speeds = {robot: params["speed"] for robot, params in swarm.params().items()}
    assert speeds == {"r1": 0.1, "r2": 0.05}
    differing = [one for one in swarm.goal() if not one.is_as_desired]
    assert [one.robot for one in differing] == ["r2"]
    assert "speed" in differing[0].reason
    assert {one.robot for one in swarm.states("r1", seconds=0.2, poses=True)} <= {"r1"}
    first = itertools.islice(swarm.states("r1", seconds=CAP, poses=True), 4)
    assert [(one.robot, math.isfinite(one.x)) for one in first] == [("r1", True)] * 4
    assert swarm.describe("r1").why.startswith("running drive")
    outcome = swarm.stop()
    assert (outcome.exit_code, outcome.applied) == (0, BOTH)
    assert {one.status.state for one in swarm.members().values() if one.status} == {State.STOPPED}
    assert swarm.resume().refused == BOTH  # the goal is to stand
    assert swarm.undo().applied == BOTH
    assert "drive" in swarm.members()._repr_html_()


def test_an_emergency_stop_lasts_until_a_reset(swarm: Client) -> None:
    assert swarm.estop(reason="a person", until_all=True).applied == BOTH
    refused = typed_in_time(lambda: swarm.run("drive", "r[1-2]"))
    assert (refused.exit_code, refused.refused) == (REFUSED, BOTH)
    assert {one.refusal for one in refused.replies.values()} == {Refusal.ESTOPPED}
    assert swarm.reset(reason="it is gone").applied == BOTH
    assert typed_in_time(lambda: swarm.run("drive", "r1")).applied == ("r1",)


def test_labels_choose_robots(swarm: Client) -> None:
    assert swarm.label("+red", "r2").exit_code == 0
    assert typed_in_time(lambda: swarm.run("drive", labels="red")).applied == ("r2",)
    assert swarm.stop(labels=["red"]).applied == ("r2",)
    assert swarm.label("-red").applied == BOTH


def test_a_robot_without_an_answer_is_named(
    swarm: Client, daemons: dict[str, DaemonProcess]
) -> None:
    swarm.members()
    daemons["r2"].freeze()
    outcome = typed_in_time(lambda: swarm.run("drive", timeout=4.0))
    assert (outcome.exit_code, outcome.applied, outcome.missing) == (PARTIAL, ("r1",), ("r2",))
    with pytest.raises(RequestError, match="r2") as caught:
        swarm.wait("state=running", "r2", timeout=0.5)
    assert caught.value.exit_code == TIMEOUT


def test_mistakes_are_refused_before_a_robot_moves(swarm: Client) -> None:
    nobody: list[str] = []
    for robots in ("r9", nobody):
        with pytest.raises(RequestError) as caught:
            swarm.run("drive", robots)
        assert caught.value.exit_code == NO_TARGET
    assert typed_in_time(lambda: swarm.run("drifting")).exit_code == USAGE
    assert typed_in_time(lambda: swarm.run("drive", params={"sped": 1})).mistake
    with pytest.raises(ConfigError, match="canary"):
        swarm.run("drive", canary=1, at=1.0)
    with pytest.raises(ConfigError, match="speed"):
        swarm.param({"speed": float("nan")})
    with pytest.raises(RequestError, match="r1"):
        swarm.describe("r9")
    assert {one.status.state for one in swarm.members().values() if one.status} <= {
        State.IDLE,
        State.STOPPED,
    }


def test_a_swarm_that_is_not_there(monkeypatch: pytest.MonkeyPatch, name: str) -> None:
    with swarmd.connect(unique_swarm(), timeout=0.5) as nobody:
        for ask in (nobody.members, nobody.stop, lambda: nobody.run("drive")):
            with pytest.raises(NetworkError, match="can be reached"):
                ask()
    with pytest.raises(ConfigError, match="feild"):
        swarmd.connect(name, profile="feild")


def test_a_closed_connection_asks_nothing_and_its_lease_ends(
    shared_swarm: Swarm, name: str
) -> None:
    with swarmd.connect(name) as swarm:
        assert typed_in_time(lambda: swarm.run("drive", "r1", lease=1.0)).applied == ("r1",)
    with pytest.raises(SwarmError, match="closed"):
        swarm.members()
    ended = shared_swarm.await_status("r1", "stopped", lambda one: one.state is State.STOPPED)
    assert ended.reason is Reason.LEASE_ENDED


OPENED = """
import os, signal, sys, threading, swarmd
swarm = swarmd.connect().open()
assert swarm.run("drive", "r1", lease=1.0).applied
"""
OPENED_IN_A_LOOP = """
import asyncio, swarmd
loop = asyncio.new_event_loop()
swarm = loop.run_until_complete(swarmd.connect().__aenter__())
assert loop.run_until_complete(swarm.run("drive", "r1", lease=1.0)).applied
waiting = loop.create_task(swarm.wait("state=faulted", timeout=1e6))
loop.run_until_complete(asyncio.sleep(0.0))
"""
WORKER = "threading.Thread(target=lambda: list(swarm.states()))"
POOL = """
from concurrent.futures import ThreadPoolExecutor
ThreadPoolExecutor().submit(lambda: list(swarm.states()))
"""


@pytest.mark.parametrize(
    ("script", "code"),
    [
        pytest.param(OPENED, 0, id="end_of_file"),
        pytest.param(f"{OPENED}raise RuntimeError", 1, id="raise"),
        pytest.param(f"{OPENED}sys.exit(3)", 3, id="exit"),
        pytest.param(f"{OPENED}signal.raise_signal(signal.SIGINT)", -2, id="ctrl_c"),
        pytest.param(f"{OPENED}{WORKER}.start()\nraise RuntimeError", 1, id="worker_thread"),
        pytest.param(f"{OPENED}{POOL}raise RuntimeError", 1, id="worker_of_a_pool"),
        pytest.param(f"{OPENED}states = swarm.states()\nnext(states)", 0, id="iterator"),
        pytest.param(f"{OPENED_IN_A_LOOP}loop.close()", 0, id="closed_loop"),
    ],
)
def test_a_script_that_ends_ends_its_connection(
    shared_swarm: Swarm, name: str, script: str, code: int
) -> None:
    """With its own exit code, and its lease is renewed no longer."""
    ended = subprocess.run(
        [sys.executable, "-c", script], capture_output=True, text=True, check=False, timeout=CAP
    )
    assert ended.returncode == code, ended.stderr
    assert "FATAL" not in ended.stderr
    assert "Exception ignored" not in ended.stderr
    stopped = shared_swarm.await_status("r1", "stopped", lambda one: one.state is State.STOPPED)
    assert stopped.reason is Reason.LEASE_ENDED


FAILS_IN_A_LOOP = """
import asyncio, swarmd
async def main():
    swarm = swarmd.connect().open()
    outcome = swarm.run("drive", "r1", lease=1.0)
    print(outcome.replies["r1"].epoch.revision, flush=True)
    waiting = asyncio.create_task(asyncio.to_thread(input))
    await asyncio.sleep(0.1)
    raise RuntimeError
asyncio.run(main())
"""


def test_a_script_that_fails_in_a_loop_renews_nothing_while_a_thread_waits(
    shared_swarm: Swarm, name: str
) -> None:
    """`asyncio.run` waits for the thread of `to_thread` with the main thread alive."""
    script = subprocess.Popen(
        [sys.executable, "-c", FAILS_IN_A_LOOP],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )
    try:
        assert script.stdout is not None
        revision = int(script.stdout.readline())  # of the run
        stopped = shared_swarm.await_status(
            "r1",
            "stopped",
            lambda one: one.state is State.STOPPED and one.epoch.revision > revision,
        )
        assert stopped.reason is Reason.LEASE_ENDED
        assert script.poll() is None  # it still waits
        _, errors = script.communicate("\n", timeout=CAP)
        assert (script.returncode, "RuntimeError" in errors) == (1, True)
    finally:
        script.kill()
        script.wait()


def lease_end(swarm: Client, robot: str) -> float:
    """When the run of a robot ends by its lease, on the clock of its daemon."""
    status = swarm.members()[robot].status
    assert status is not None
    assert status.goal is not None
    assert status.goal.lease_left is not None, status
    return status.uptime + status.goal.lease_left


def test_a_forked_child_ends_by_itself(shared_swarm: Swarm, name: str) -> None:
    """It has no thread of the connection, and the lease of its parent goes on."""
    script = f"""{OPENED}
if not (child := os.fork()):
    sys.exit(5)
assert os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]) == 5
assert swarm.stop("r1").applied
"""
    ended = subprocess.run(
        [sys.executable, "-c", script], capture_output=True, text=True, check=False, timeout=CAP
    )
    assert (ended.returncode, ended.stderr) == (0, "")


FORKED = """
import os, sys, time, swarmd
from swarmd.core.errors import ForkedError, NetworkError, RequestError
swarm = swarmd.connect().open()
parent = os.getpid()
def in_time(ask):
    while True:  # a machine that stalls may have robots heard late
        try:
            if answer := ask():
                return answer
        except ForkedError as error:
            assert str(parent) in str(error), error
            return "forked"
        except (NetworkError, RequestError):
            time.sleep(0.1)
assert in_time(lambda: swarm.run("drive", "r1", lease=60.0).applied) == ("r1",)
states = swarm.states()
next(states)
assert in_time(swarm.members)  # its operator waits for the next call
def work():
    assert in_time(swarm.members) == "forked"
    assert in_time(lambda: list(swarm.states(seconds=1.0))) == "forked"
    assert in_time(lambda: list(states)) == "forked"
    assert in_time(lambda: swarm.run("drive", "r1", lease=1.0)) == "forked"
    assert in_time(lambda: swarm.stop("r2").applied) == ("r2",)
    assert in_time(lambda: swarm.estop("r2").applied) == ("r2",)
    swarm.close()
    sys.exit(5)
"""
FORK = "child = os.fork()\nif not child: work()\nstatus = os.waitpid(child, 0)[1]\n"
WORKER_PROCESS = """
import multiprocessing
child = multiprocessing.get_context("fork").Process(target=work)
child.start()
child.join()
status = child.exitcode << 8
"""
AFTERWARDS = """
assert os.waitstatus_to_exitcode(status) == 5
assert swarm.wait("state=running", "r1", timeout=60.0) == ("r1",)
assert swarm.wait("state=estopped", "r2", timeout=60.0) == ("r2",)
assert in_time(lambda: swarm.stop("r1").applied) == ("r1",)
"""


@pytest.mark.parametrize("fork", [FORK, WORKER_PROCESS], ids=["fork", "multiprocessing"])
def test_a_fork_stops_robots_and_is_told_what_it_cannot_do(
    shared_swarm: Swarm, name: str, fork: str
) -> None:
    """The robots of its parent go on under their lease, also once the fork has ended."""
    ended = subprocess.run(
        [sys.executable, "-c", f"{FORKED}{fork}{AFTERWARDS}"],
        capture_output=True,
        text=True,
        check=False,
        timeout=CAP,
    )
    assert (ended.returncode, ended.stderr) == (0, "")


def test_a_stop_is_sent_at_exit(name: str, shared_swarm: Swarm) -> None:
    script = f"{OPENED}import atexit; atexit.register(swarm.stop)"
    ended = subprocess.run(
        [sys.executable, "-c", script], capture_output=True, text=True, check=False, timeout=CAP
    )
    assert (ended.returncode, ended.stderr) == (0, "")
    stopped = shared_swarm.await_status("r1", "stopped", lambda one: one.state is State.STOPPED)
    assert stopped.reason is Reason.OPERATOR


async def typed(start: Callable[[], Awaitable[Outcome]]) -> Outcome:
    """As `typed_in_time`, in a loop."""
    while True:
        try:
            return await start()
        except RequestError as error:
            if not STALLED.search(str(error)):
                raise


async def test_two_clients_in_one_program(name: str) -> None:
    """One of them blocks inside the running loop, as the cells of a notebook do."""
    async with swarmd.connect(name) as one:
        with swarmd.connect(name) as other:
            assert other.estop().applied == BOTH
            assert (await typed(lambda: one.run("drive"))).refused == BOTH
            assert other.reset().applied == BOTH
        assert (await typed(lambda: one.run("drive"))).applied == BOTH


async def test_events_tell_what_others_do(name: str) -> None:
    async with swarmd.connect(name) as swarm:
        await typed(lambda: swarm.run("drive"))
        goal = (await swarm.goal("r1"))[0].goal
        assert goal is not None
        events = swarm.events("r1", since=30.0)
        while f"goal {goal.generation} " not in (told := await anext(events)).text:
            assert told.robot == "r1"
        heard = set[str]()
        async for one in swarm.states(seconds=CAP):
            heard.add(one.robot)
            if heard == set(BOTH):
                break
        assert heard == set(BOTH)
    assert {one.robot async for one in events} <= {"r1"}  # it ends with the connection


async def test_a_stop_overtakes_a_request_that_waits(
    name: str, daemons: dict[str, DaemonProcess]
) -> None:
    async with swarmd.connect(name) as swarm:
        await swarm.members()
        daemons["r2"].freeze()
        waiting = asyncio.create_task(swarm.run("drive", "r2", timeout=8.0))
        await asyncio.to_thread(wait_until, is_handed_over, "the request is under way")
        stopped = await swarm.stop("r1")
        assert stopped.applied == ("r1",)
        assert not waiting.done()
        daemons["r2"].thaw()
        await waiting


async def test_a_cancelled_wait_ends_and_so_does_its_thread(name: str) -> None:
    async with swarmd.connect(name) as swarm:
        task = asyncio.create_task(swarm.wait("state=faulted", timeout=60.0))
        await asyncio.to_thread(wait_until, is_handed_over, "the wait has begun")
        task.cancel()
        with pytest.raises(asyncio.CancelledError):
            await task
        await asyncio.to_thread(wait_until, lambda: not is_handed_over(), "its thread has ended")


async def test_a_start_that_is_cancelled_before_its_moment_does_not_happen(
    name: str, shared_swarm: Swarm, caplog: pytest.LogCaptureFixture
) -> None:
    before = shared_swarm.status("r1").epoch.revision
    async with swarmd.connect(name) as swarm:
        start = asyncio.create_task(swarm.run("drive", "r1", at=40.0))
        asked = await asyncio.to_thread(
            shared_swarm.await_status, "r1", "asked", lambda one: one.epoch.revision > before
        )
        start.cancel()
        with pytest.raises(asyncio.CancelledError):
            await start
        await asyncio.to_thread(wait_until, lambda: not is_handed_over(), "its thread has ended")
        assert shared_swarm.status("r1").epoch.revision > asked.epoch.revision
        assert "1 targeted, 1 applied" in caplog.text  # the stop
        started = await typed(lambda: swarm.run("drive", "r1"))
        assert started.applied == ("r1",)  # and not: still loading


async def test_a_start_that_is_cancelled_while_its_process_stands_still_does_not_happen(
    name: str, shared_swarm: Swarm
) -> None:
    before = shared_swarm.status("r1").epoch.revision
    async with swarmd.connect(name) as swarm:
        start = asyncio.create_task(swarm.run("drive", "r1", at=40.0))
        asked = await asyncio.to_thread(
            shared_swarm.await_status, "r1", "asked", lambda one: one.epoch.revision > before
        )
        go_on = subprocess.Popen(["sh", "-c", f"sleep 1.8; kill -CONT {os.getpid()}"])
        start.cancel()
        await asyncio.sleep(0.0)
        os.kill(os.getpid(), signal.SIGSTOP)
        go_on.wait()
        with pytest.raises(asyncio.CancelledError):
            await start
        await asyncio.to_thread(wait_until, lambda: not is_handed_over(), "its thread has ended")
        assert shared_swarm.status("r1").epoch.revision > asked.epoch.revision


def test_closing_ends_what_another_thread_waits_for(name: str) -> None:
    errors: list[SwarmError] = []
    swarm = swarmd.connect(name).open()

    def wait() -> None:
        try:
            swarm.wait("state=faulted", timeout=60.0)
        except SwarmError as error:
            errors.append(error)

    thread = threading.Thread(target=wait)
    thread.start()
    states = swarm.states()
    next(states)
    swarm.close()
    thread.join(CAP)
    assert not thread.is_alive()
    assert len(errors) == 1
    assert len(list(states)) < MAX_WAITING  # it ends


def is_handed_over() -> bool:
    return any(thread.name == HAND_OVER for thread in threading.enumerate())


def test_keys_are_those_of_swarmctl(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    for key in ("HOME", "XDG_CACHE_HOME", "XDG_CONFIG_HOME"):
        monkeypatch.setenv(key, str(tmp_path))
    with contextlib.ExitStack() as left:
        secured = SecuredSwarm(tmp_path, left).start()
        keys = secured.keys
        with swarmd.connect(secured.name, identity=keys.folder_of("anna")) as swarm:
            assert swarm.stop().applied == BOTH
            assert typed_in_time(lambda: swarm.run("drive", "r1", lease=8.0)).applied == ("r1",)
            first = lease_end(swarm, "r1")
            wait_until(lambda: lease_end(swarm, "r1") > first + 1.0, "the lease is renewed")
        with swarmd.connect(secured.name, identity=keys.folder_of("class")) as viewer:
            assert viewer.members().alive == BOTH
            with pytest.raises(ConfigError, match="may only look"):
                viewer.stop()
        with (
            swarmd.connect(secured.name, insecure=True, timeout=1.0) as stranger,
            pytest.raises(NetworkError, match="no keys"),
        ):
            stranger.members()


def test_one_robot_in_the_hand_of_a_program(swarm: Client) -> None:
    """The hand moves it, others see who drives, a second hand is told, and a release ends it."""

    def is_done() -> bool:
        """False if a process was stopped for longer than the lease, or answered too late."""
        pause = threading.Event()
        with contextlib.suppress(RequestError), swarm.drive("r1") as hand:
            while not hand.is_over:
                hand.move(0.1)
                pause.wait(0.05)
                status = hand.status
                if status is not None and status.decision.safe_linear > 0.0:
                    return is_told(status.driven_by)
        return False

    def is_told(name: str) -> bool:
        """Another hand learns who drives."""
        try:
            swarm.drive("r1").close()
        except RequestError as refused:
            return refused.exit_code == REFUSED and f"driven by {name}" in str(refused)
        return False

    def is_free() -> bool:
        status = swarm.members()["r1"].status
        return status is not None and not status.driven_by

    wait_until(is_done, "a hand moves r1")
    wait_until(is_free, "r1 is in nobody's hand")
