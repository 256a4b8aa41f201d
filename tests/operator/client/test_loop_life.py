"""What a lease belongs to: the loop of its caller, or of its connection, or the program.

With real loops, and operators that only count leases; with robots: tests/swarm/test_python.py.
"""

from __future__ import annotations

import asyncio
import threading
from collections.abc import Awaitable, Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack, contextmanager
from types import SimpleNamespace
from typing import TYPE_CHECKING, Any, cast

import pytest

from swarmd.core.errors import SwarmError
from swarmd.core.goal import Goal
from swarmd.core.messages import Code, Reply
from swarmd.link.settings import NetworkSettings
from swarmd.operator.client.async_swarm import AsyncSwarm
from swarmd.operator.client.connect import Connection
from swarmd.operator.client.loop_life import LoopLife
from swarmd.operator.client.swarm import Swarm
from swarmd.operator.session.members_view import MembersView
from swarmd.operator.session.outcome import Outcome
from swarmd.operator.session.session import Session
from swarmd.operator.verbs.run import ask as runs
from swarmd.operator.verbs.run.ask import Run, StartedRun
from swarmd.operator.verbs.run.lease import LeaseKeeper
from tests.support.processes import CAP, wait_until
from tests.support.statuses import make_member

if TYPE_CHECKING:
    from swarmd.operator.session.operator import Operator
    from swarmd.operator.session.session import TargetedView

APPLIED = Outcome(replies={"r1": Reply(id="a", robot="r1", code=Code.APPLIED)})


class ScriptError(Exception):
    """The script of a user fails."""


@contextmanager
def in_a_thread(work: Callable[[], object]) -> Iterator[threading.Thread]:
    """Run `work`, which may raise ScriptError, in a thread, until it ends."""

    def run() -> None:
        try:
            work()
        except* ScriptError:
            pass

    thread = threading.Thread(target=run, daemon=True)
    thread.start()
    yield thread
    thread.join(CAP)
    assert not thread.is_alive()


def made_by(loop: asyncio.AbstractEventLoop) -> LoopLife:
    """The life of a loop, which is asked for by code on the loop."""

    async def make() -> LoopLife:
        life = LoopLife.of_caller()
        assert life is not None
        return life

    return loop.run_until_complete(make())


# The loop


def test_outside_of_a_loop_nothing_is_watched() -> None:
    assert LoopLife.of_caller() is None


@pytest.mark.parametrize("is_in_a_group", [False, True])
def test_a_loop_that_waits_for_threads_after_an_error_is_over(is_in_a_group: bool) -> None:
    """As `asyncio.run` of a script that fails while `asyncio.to_thread(input)` waits."""
    lives, typed = list[LoopLife](), threading.Event()

    async def main() -> None:
        lives.append(cast("LoopLife", LoopLife.of_caller()))
        if is_in_a_group:
            async with asyncio.TaskGroup() as group:
                group.create_task(asyncio.to_thread(typed.wait, CAP))
                await asyncio.sleep(0.0)
                raise ScriptError
        waiting = asyncio.create_task(asyncio.to_thread(typed.wait, CAP))
        await asyncio.sleep(0.0)
        assert not waiting.done()
        assert not lives[0].is_over
        raise ScriptError

    with in_a_thread(lambda: asyncio.run(main())) as thread:
        wait_until(lambda: bool(lives) and lives[0].is_over, "the loop is over")
        assert thread.is_alive()  # it waits for the input
        typed.set()


def test_the_end_of_a_task_ends_nothing() -> None:
    """A child of a task group, the handler of a web server, a cell of a notebook."""

    async def handler() -> LoopLife:
        life = LoopLife.of_caller()
        assert life is not None
        return life

    async def main() -> LoopLife:
        async with asyncio.TaskGroup() as group:
            child = group.create_task(handler())
        life = child.result()
        failed = asyncio.create_task(asyncio.sleep(CAP))
        failed.cancel()
        await asyncio.wait([failed])
        assert not life.is_over
        return life

    assert asyncio.run(main()).is_over


def test_a_loop_goes_on_between_two_calls_and_is_over_once_it_is_closed() -> None:
    loop = asyncio.new_event_loop()
    life = made_by(loop)
    assert not life.is_over
    loop.run_until_complete(asyncio.sleep(0.0))
    assert not life.is_over
    loop.close()
    assert life.is_over


@pytest.mark.parametrize("step", ["shutdown_asyncgens", "shutdown_default_executor"])
def test_each_step_of_a_shutdown_ends_it(step: str) -> None:
    loop = asyncio.new_event_loop()
    life = made_by(loop)
    shut_down: Callable[[], Awaitable[None]] = getattr(loop, step)

    async def shut() -> None:
        await shut_down()

    loop.run_until_complete(shut())
    assert life.is_over
    loop.close()


def test_another_loop_than_that_of_asyncio_is_asked_whether_it_is_closed() -> None:
    """uvloop has no private attribute of asyncio."""
    state = {"closed": False}
    loop = SimpleNamespace(is_closed=lambda: state["closed"], is_running=lambda: False)
    with LoopLife(cast("asyncio.AbstractEventLoop", loop)) as life:
        assert not life.is_over
        state["closed"] = True
        assert life.is_over


def test_a_loop_whose_code_blocks_goes_on() -> None:
    lives, blocks, go_on = list[LoopLife](), threading.Event(), threading.Event()

    async def main() -> None:
        lives.append(cast("LoopLife", LoopLife.of_caller()))
        blocks.set()
        go_on.wait(CAP)

    with in_a_thread(lambda: asyncio.run(main())):
        assert blocks.wait(CAP)
        assert not lives[0].is_over
        go_on.set()


def test_a_loop_whose_thread_has_ended_is_over_unless_another_one_runs_it() -> None:
    loop, lives = asyncio.new_event_loop(), list[LoopLife]()
    with in_a_thread(lambda: lives.append(made_by(loop))):
        pass
    assert lives[0].is_over

    async def look() -> bool:
        return lives[0].is_over

    assert not loop.run_until_complete(look())
    loop.close()


def test_a_watch_is_no_task_and_ends_without_a_trace() -> None:
    async def main() -> int:
        life = LoopLife.of_caller()
        assert life is not None
        tasks = len(asyncio.all_tasks())
        life.close()
        life.close()
        return tasks

    assert asyncio.run(main(), debug=True) == 1


# The lease


class Leasing:
    """A connection whose runs are applied at once; `owners`: whether each lease is still owned."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch) -> None:
        self.owners: list[Callable[[], bool]] = []
        operator = SimpleNamespace(
            settings=NetworkSettings(swarm="s"),
            identity=None,
            notices=[],
            members=lambda **_: MembersView({"r1": make_member("r1")}),
            close=lambda: None,
        )
        self.connection = Connection(lambda tell: cast("Operator", operator))
        monkeypatch.setattr(runs, "carry_out", self._carry_out)
        monkeypatch.setattr("swarmd.operator.session.session.remember", lambda *_: None)

    def _carry_out(
        self, run: Run, targeted: TargetedView, targets: object, opened: ExitStack
    ) -> StartedRun:
        self.owners.append(targeted.session.is_owned)
        return StartedRun(Goal(generation=1, issuer="anna", id="g"), APPLIED)

    def lease(self, swarm: Swarm) -> Callable[[], bool]:
        """Start a run with a lease; returns whether it is owned."""
        assert swarm.run("drive", lease=5.0).applied == ("r1",)
        return self.owners[-1]


@pytest.fixture
def leasing(monkeypatch: pytest.MonkeyPatch) -> Leasing:
    return Leasing(monkeypatch)


def test_a_lease_of_a_script_is_owned_until_the_main_thread_ends(
    leasing: Leasing, monkeypatch: pytest.MonkeyPatch
) -> None:
    swarm = leasing.connection.open()
    is_owned = leasing.lease(swarm)
    assert is_owned()
    monkeypatch.setattr(threading, "_SHUTTING_DOWN", True, raising=False)
    assert not is_owned()
    monkeypatch.undo()
    swarm.close()


def test_a_look_of_a_thread_ends_no_lease_of_another_loop(
    leasing: Leasing, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The connection was opened on a loop that is over."""
    ended: list[str] = []
    carry_out = runs.carry_out

    def noted(run: Run, targeted: TargetedView, targets: Any, opened: ExitStack) -> StartedRun:
        opened.callback(ended.append, "lease")
        return carry_out(run, targeted, targets, opened)

    monkeypatch.setattr(runs, "carry_out", noted)

    async def opened() -> Swarm:
        return leasing.connection.open()

    async def leased(swarm: Swarm) -> bool:
        is_owned = leasing.lease(swarm)
        await asyncio.to_thread(swarm.members)
        return is_owned()

    swarm = asyncio.run(opened())
    assert asyncio.run(leased(swarm))
    assert ended == []
    swarm.close()
    assert ended == ["lease"]


def test_a_lease_that_is_asked_for_on_a_loop_ends_with_that_loop(leasing: Leasing) -> None:
    """Wherever the connection was opened."""
    swarm = leasing.connection.open()

    async def main() -> Callable[[], bool]:
        is_owned = leasing.lease(swarm)
        await asyncio.sleep(0.0)
        assert is_owned()
        return is_owned

    first = asyncio.run(main())
    assert not first()
    loop = asyncio.new_event_loop()
    second = loop.run_until_complete(main())
    assert second()  # as between two cells
    loop.close()
    assert not second()
    swarm.close()


def test_a_lease_of_a_thread_ends_with_the_loop_of_its_connection(leasing: Leasing) -> None:
    async def blocking() -> tuple[Swarm, Callable[[], bool]]:
        swarm = leasing.connection.open()
        is_owned = await asyncio.to_thread(leasing.lease, swarm)
        assert is_owned()
        return swarm, is_owned

    swarm, is_owned = asyncio.run(blocking())
    assert not is_owned()
    with ThreadPoolExecutor() as pool, pytest.raises(SwarmError, match="not sent"):
        pool.submit(leasing.lease, swarm).result(CAP)  # a worker that goes on commands for nobody
    assert leasing.lease(swarm)()  # the main thread may go on, and its lease is its own
    swarm.close()


def test_a_lease_of_an_async_connection_ends_with_its_loop(leasing: Leasing) -> None:
    async def main() -> tuple[AsyncSwarm, Callable[[], bool]]:
        swarm = await leasing.connection.__aenter__()
        assert (await swarm.run("drive", lease=5.0)).applied == ("r1",)
        assert leasing.owners[-1]()
        return swarm, leasing.owners[-1]

    swarm, is_owned = asyncio.run(main())
    assert not is_owned()
    swarm._swarm.close()


def test_a_keeper_gets_the_owner_of_its_session(monkeypatch: pytest.MonkeyPatch) -> None:
    """`runs.carry_out` starts it, for `swarmctl run --lease` and for Python."""
    goal = Goal(generation=1, issuer="anna", id="g", pattern="drive", lease=1.0)
    monkeypatch.setattr(Run, "goal", lambda *_: goal)
    monkeypatch.setattr(runs, "send_goal", lambda *_, **__: APPLIED)
    owned, sent, ended = threading.Event(), list[int](), list[bool]()
    operator = SimpleNamespace(
        identity=None, send_lease=lambda id, count, robots: sent.append(count)
    )
    session = Session(cast("Operator", operator), is_owned=owned.is_set)
    targeted: Any = SimpleNamespace(
        session=session,
        operator=operator,
        names=("r1",),
        view=SimpleNamespace(epochs=dict.fromkeys),
        time_left=None,
    )
    keepers = list[LeaseKeeper]()
    start = LeaseKeeper.start

    def begin(keeper: LeaseKeeper) -> None:
        keepers.append(keeper)
        start(keeper)

    monkeypatch.setattr(LeaseKeeper, "start", begin)
    for is_owned in (False, True):
        owned.set() if is_owned else owned.clear()
        with ExitStack() as opened:
            runs.carry_out(Run(pattern="drive", lease=1.0), targeted, ("r1",), opened)
            wait_until(lambda: bool(sent) or not keepers[-1].is_alive(), "it renews, or ends")
        ended.append(bool(sent))
    assert ended == [False, True]


def test_the_owner_of_a_session_is_the_program_unless_another_is_named(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    session = Session(cast("Operator", None))
    assert session.is_owned()
    monkeypatch.setattr(threading, "_SHUTTING_DOWN", True, raising=False)
    assert not session.is_owned()
