"""The live client without robots: operators that are lent, options, what is shown."""

from __future__ import annotations

import asyncio
import math
import os
import queue
import threading
import time
from collections.abc import Callable, Generator
from contextlib import ExitStack, suppress
from pathlib import Path
from types import SimpleNamespace
from typing import TYPE_CHECKING, Any, cast

import pytest
import zenoh

import swarmd
from swarmd.core.errors import ConfigError, ForkedError, RequestError, SwarmError
from swarmd.core.messages import Code, Motion, Reply, State
from swarmd.link.carriers import forked
from swarmd.link.carriers.session import open_with
from swarmd.link.settings import NetworkSettings
from swarmd.operator.client.async_swarm import AsyncSwarm
from swarmd.operator.client.connect import Connection
from swarmd.operator.client.hand_over import from_thread
from swarmd.operator.client.network_options import NetworkOptions
from swarmd.operator.client.operator_pool import MAX_IDLE, MAX_REQUESTS, LookTurns, OperatorPool
from swarmd.operator.client.swarm import Swarm, _targets
from swarmd.operator.session.exit_codes import NO_TARGET
from swarmd.operator.session.members_view import MembersView
from swarmd.operator.session.outcome import Outcome
from swarmd.operator.session.session import Session
from swarmd.operator.session.states import RobotState, _put
from swarmd.operator.session.targets import Targets, check_words, plain_params
from swarmd.operator.verbs.members.ask import Members
from swarmd.operator.verbs.run.ask import Run
from swarmd.operator.verbs.run.canary import choose_canaries
from swarmd.operator.verbs.run.lease import LeaseKeeper
from swarmd.settings.contexts import Context, add_context
from tests.support.processes import CAP, wait_until
from tests.support.statuses import make_member
from tests.support.statuses import status as make_status

if TYPE_CHECKING:
    from swarmd.operator.session.operator import Operator


class Counted:
    """Makes operators, and counts those that are open."""

    def __init__(self) -> None:
        self.made = self.open = 0

    def __call__(self) -> Any:
        self.made += 1
        self.open += 1
        return SimpleNamespace(close=self._close)

    def _close(self) -> None:
        self.open -= 1


def test_an_operator_is_lent_again_and_none_is_left_open() -> None:
    made = Counted()
    pool = OperatorPool(made)
    for _ in range(3):
        with pool.lend() as one:
            assert one is not None
    assert made.made == 1
    with pool.lend() as first, pool.lend() as second, pool.lend() as third:
        assert len({id(first), id(second), id(third)}) == 3  # no verb waits for another one
    assert (made.made, made.open) == (3, MAX_IDLE)
    with pool.lend() as kept:
        pool.close()
        assert made.open == 1
        assert kept is not None
    assert made.open == 0
    with pytest.raises(SwarmError, match="closed"), pool.lend():
        pass


def test_a_stop_of_an_acceptance_test_is_sent_after_its_connection_was_closed() -> None:
    """A task that is cancelled at once leaves its block before the robot is told to stop."""
    made = Counted()
    swarm = Swarm(OperatorPool(made))
    call = swarm._cancellable(threading.Event())
    swarm.close()
    with pytest.raises(SwarmError, match="closed"), call._sessions():
        pass
    with call._sessions(is_stop=True) as session:
        assert not session.is_cancelled()
        assert made.open == 1
    assert made.open == 0


def test_an_operator_that_failed_is_closed() -> None:
    made = Counted()
    pool = OperatorPool(made)
    with pytest.raises(RequestError), pool.lend():
        raise RequestError("no robot", NO_TARGET)
    assert made.open == 0


def test_a_stop_is_lent_an_operator_where_a_request_is_refused() -> None:
    pool = OperatorPool(Counted())
    held = [pool.lend_for_request() for _ in range(MAX_REQUESTS)]
    for one in held:
        one.__enter__()
    with pytest.raises(SwarmError, match="not sent"), pool.lend_for_request():
        pass
    with pool.lend() as free:
        assert free is not None
    held[0].__exit__(None, None, None)
    with pool.lend_for_request() as again:
        assert again is not None


class Held:
    """An operator whose looks wait for `go_on`; its robots acknowledge a stop at once."""

    identity = None
    settings = NetworkSettings(swarm="s")

    def __init__(self) -> None:
        self.notices: list[str] = []
        self.made = self.looks = 0
        self.begun, self.go_on = threading.Event(), threading.Event()

    def __call__(self) -> Any:
        self.made += 1
        return self

    def members(self, **_: object) -> MembersView:
        self.looks += 1
        self.begun.set()
        assert self.go_on.wait(CAP)
        return MembersView({"r1": make_member("r1")})

    def seen(self) -> MembersView:
        return MembersView({"r1": make_member("r1")})

    def send_stop(self, verb: str, **_: object) -> Outcome:
        return Outcome({"r1": Reply(id="1", robot="r1", code=Code.APPLIED)})

    def close(self) -> None:
        """Has nothing to close."""


async def test_a_stop_comes_before_a_flood_of_looks_that_share_one_operator(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))  # a look keeps the names of robots
    held, threads_before = Held(), threading.active_count()
    swarm = AsyncSwarm(Swarm(OperatorPool(held)))
    looks = [asyncio.create_task(swarm.members()) for _ in range(300)]
    try:
        assert await asyncio.to_thread(held.begun.wait, CAP)
        outcome = await swarm.stop()
        assert (outcome.applied, held.made, held.looks) == (("r1",), 2, 1)
        assert not any(look.done() for look in looks)
        assert threading.active_count() - threads_before < 20
    finally:
        held.go_on.set()
    assert all("r1" in members for members in await asyncio.gather(*looks))
    assert held.looks < len(looks)


def test_looks_take_turns_and_share_one_that_began_after_them() -> None:
    turns, begun, go_on = LookTurns(), threading.Event(), threading.Event()
    results: queue.SimpleQueue[str] = queue.SimpleQueue()

    def first() -> str:
        begun.set()
        assert go_on.wait(CAP)
        return "before"

    def later() -> str:
        counted.append(1)
        return "after"

    counted = list[int]()
    threads = [threading.Thread(target=lambda: results.put(turns.share("look", first)))]
    threads[0].start()
    assert begun.wait(CAP)
    with pytest.raises(SwarmError, match="under way"):
        turns.share("look", later, timeout=0.01)
    for _ in range(9):
        threads.append(threading.Thread(target=lambda: results.put(turns.share("look", later))))
        threads[-1].start()
    # Numbers: two of the first call and its look, one of the call without a turn, nine more.
    wait_until(lambda: repr(turns._order) == "count(12)", "all wait for their turn")
    go_on.set()
    for thread in threads:
        thread.join(CAP)
    assert sorted(results.get() for _ in threads) == ["after"] * 9 + ["before"]
    assert len(counted) == 1
    assert turns.share("look", lambda: "new") == "new"
    assert turns.share("another", lambda: "other") == "other"


def test_a_connection_is_in_one_block_at_a_time() -> None:
    made = Counted()
    connection = Connection(lambda _: made())
    with connection, pytest.raises(ConfigError, match="in a block already"), connection:
        pass
    with connection:
        assert made.open == 1
    assert made.open == 0


async def test_a_task_that_is_cancelled_while_it_connects_leaves_nothing_open() -> None:
    made, begun, go_on = Counted(), threading.Event(), threading.Event()
    closed = threading.Event()

    def make(_: object) -> Any:
        begun.set()
        go_on.wait(10.0)
        operator = made()

        def close() -> None:
            operator.close()
            closed.set()

        return SimpleNamespace(close=close)

    async def enter() -> None:
        async with Connection(make):
            pass

    task = asyncio.create_task(enter())
    assert await asyncio.to_thread(begun.wait, 10.0)
    task.cancel()
    with pytest.raises(asyncio.CancelledError):
        await task
    go_on.set()
    assert await asyncio.to_thread(closed.wait, 10.0)
    assert (made.made, made.open) == (1, 0)


def test_no_lease_outlives_the_connection_or_a_later_run_of_its_robots() -> None:
    pool, ended = OperatorPool(Counted()), list[str]()

    def lease(name: str) -> ExitStack:
        opened = ExitStack()
        opened.callback(ended.append, name)
        return opened

    pool.keep_lease(["r1"], lease("one"))
    pool.keep_lease(["r2", "r3"], lease("two"))
    pool.keep_lease(["r1", "r2"], lease("three"))
    assert ended == ["one"]  # r3 runs on under the second one
    pool.close()
    assert sorted(ended) == ["one", "three", "two"]
    pool.keep_lease(["r1"], lease("late"))  # of a run that was under way as the pool closed
    assert ended[-1] == "late"


def test_a_fork_has_operators_of_its_own_and_leaves_what_its_parent_holds(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    made, ended = Counted(), list[str]()
    pool = OperatorPool(made)
    with pool.here().lend() as of_parent:
        pass
    lease = ExitStack()
    lease.callback(ended.append, "lease")
    pool.keep_lease(["r1"], lease)
    assert pool.here() is pool
    pool._lock.acquire()  # as another thread of the parent may at the moment of the fork
    parent = os.getpid()
    with monkeypatch.context() as fork:
        fork.setattr(os, "getpid", lambda: parent + 1)
        child = pool.here()
        assert child is pool.here() is not pool
        with child.lend() as own:
            assert own is not of_parent
        child.close()
        with pytest.raises(SwarmError, match="closed"), pool.here().lend():
            pass
    pool._lock.release()
    assert (made.made, made.open, ended) == (2, 1, [])
    with pool.here().lend() as again:
        assert again is of_parent
    pool.close()
    assert ended == ["lease"]
    with monkeypatch.context() as fork:
        fork.setattr(os, "getpid", lambda: parent + 2)
        with pytest.raises(SwarmError, match="closed"), pool.here().lend():
            pass


def test_an_operator_that_a_fork_has_from_its_parent_is_not_closed(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    made, parent = Counted(), os.getpid()
    pool = OperatorPool(made)
    with monkeypatch.context() as fork:
        with suppress(RequestError), pool.lend():
            fork.setattr(os, "getpid", lambda: parent + 1)
            raise RequestError("no robot", NO_TARGET)
        assert made.open == 1
    pool.close()


def test_a_fork_of_a_process_that_uses_zenoh_opens_no_session(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    forked._process_of_zenoh.cache_clear()
    forked.check_not_forked("nothing")
    parent = os.getpid()
    with monkeypatch.context() as fork:
        fork.setattr(os, "getpid", lambda: parent + 1)
        fork.setattr(zenoh, "open", lambda config: pytest.fail("Zenoh hangs in a fork"))
        with pytest.raises(ForkedError, match=str(parent)) as refused:
            open_with({}, "swarm 'meadow'")
        assert "spawn" in str(refused.value)
    forked.check_not_forked("nothing")


def test_an_iterator_of_the_parent_ends_in_a_fork_with_an_error(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    swarm, parent = Swarm(OperatorPool(Counted())), os.getpid()
    with swarm._session(None) as session, monkeypatch.context() as fork:
        assert not session.is_cancelled()
        fork.setattr(os, "getpid", lambda: parent + 1)
        with pytest.raises(ForkedError, match=str(parent)):
            session.is_cancelled()


def test_a_lease_is_renewed_only_while_it_is_owned() -> None:
    owned, sent = iter([True, True, False]), list[int]()

    def send(goal: str, count: int, robots: object) -> None:
        sent.append(count)

    operator = cast("Operator", SimpleNamespace(send_lease=send))
    keeper = LeaseKeeper(operator, "goal", 0.01, ["r1"], is_owned=lambda: next(owned))
    keeper.run()  # ends by itself
    assert sent == [1, 2]


def test_a_context_by_name_and_a_swarm_file_of_the_environment(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("HOME", str(tmp_path))
    for name in ("XDG_CONFIG_HOME", "SWARM", "SWARM_CONTEXT"):
        monkeypatch.delenv(name, raising=False)
    add_context("lab", Context(swarm="lab", interface="wlan7"))
    add_context("field", Context(swarm="meadow"), use=True)
    assert NetworkOptions().in_context().swarm == "meadow"
    assert NetworkOptions(context="lab").in_context().interface == "wlan7"
    with pytest.raises(ConfigError, match="lab"):
        NetworkOptions(context="lap").in_context()
    monkeypatch.setenv("SWARM_CONFIG", str(tmp_path / "none.yaml"))
    with pytest.raises(ConfigError, match="none"), swarmd.connect():
        pass
    with pytest.raises(ConfigError, match="lab"):
        swarmd.connect(context="lap").open()


def test_robots_of_a_call() -> None:
    assert _targets(None, (), ()).is_whole_swarm
    assert _targets("tb3-[01-02]", "red", ["tb3-02"]).names == ("tb3-01", "tb3-02")
    assert _targets([], ["red"], ()).labels == ("red",)
    with pytest.raises(RequestError) as caught:
        _targets(iter(()), (), ())  # a list that is empty moves no robot
    assert caught.value.exit_code == NO_TARGET


def test_values_that_can_be_sent() -> None:
    numpy = pytest.importorskip("numpy")
    given = {"a": numpy.float64(0.5), "b": numpy.int32(3), "c": numpy.True_, "d": "x", "e": None}
    sent = plain_params(given)
    assert sent == {"a": 0.5, "b": 3, "c": True, "d": "x", "e": None}
    assert [type(sent[key]) for key in "abc"] == [float, int, bool]
    for wrong in ([1.0], float("inf"), 1j):
        with pytest.raises(ConfigError, match="speed"):
            plain_params({"speed": wrong})


def test_times_of_numpy_are_numbers(monkeypatch: pytest.MonkeyPatch) -> None:
    numpy = pytest.importorskip("numpy")
    made: list[Run] = []
    monkeypatch.setattr(Run, "check", lambda run: made.append(run))
    with pytest.raises(AttributeError):  # the operator of this test sends nothing
        Swarm(OperatorPool(Counted())).run(
            numpy.str_("drive"),
            seconds=numpy.float32(1.5),
            canary=numpy.int64(2),
            canary_time=numpy.int8(3),
        )
    assert type(made[0].pattern) is str
    values = made[0].seconds, made[0].canary, made[0].canary_time
    assert values == (1.5, 2, 3)
    assert [type(value) for value in values] == [float, int, int]


SESSIONS: dict[str, Callable[[Swarm, Any], object]] = {
    "stop": lambda swarm, time: swarm.stop(timeout=time),
    "estop": lambda swarm, time: swarm.estop(timeout=time),
    "reset": lambda swarm, time: swarm.reset(timeout=time),
    "members": lambda swarm, time: swarm.members(timeout=time),
    "members with poses": lambda swarm, time: swarm.members(poses=True, timeout=time),
    "goal": lambda swarm, time: swarm.goal(timeout=time),
    "params": lambda swarm, time: swarm.params(timeout=time),
    "wait": lambda swarm, time: swarm.wait("state=idle", timeout=time),
}


@pytest.mark.parametrize("kind", ["float16", "float32", "int8", "array"])
@pytest.mark.parametrize("verb", SESSIONS)
def test_a_timeout_of_numpy_is_a_float(
    monkeypatch: pytest.MonkeyPatch, verb: str, kind: str
) -> None:
    """A sum with float16 or float32 keeps that type: a stop was over before it was sent."""
    numpy = pytest.importorskip("numpy")
    given: list[object] = []

    def session(operator: object, timeout: float, *_: object) -> None:
        given.append(timeout)
        raise SwarmError("enough")

    monkeypatch.setattr("swarmd.operator.client.swarm.Session", session)
    with pytest.raises(SwarmError, match="enough"):
        SESSIONS[verb](Swarm(OperatorPool(Counted())), getattr(numpy, kind)(2))
    assert [type(one) for one in given] == [float]
    assert given == [2.0]


def test_texts_of_numpy_are_texts() -> None:
    numpy = pytest.importorskip("numpy")
    texts = numpy.array(["a", "b"])
    for words in (texts, list(texts), iter(texts)):
        assert [type(word) for word in check_words(words, "robots")] == [str, str]
    assert check_words(numpy.array("a"), "robots") == ("a",)
    assert check_words(texts[0], "robots") == ("a",)


def _yes(question: object) -> str:
    return "y"


WRONG: dict[str, Callable[[Swarm], object]] = {
    "pattern name": lambda swarm: swarm.run(5),  # type: ignore[arg-type]
    "on_join": lambda swarm: swarm.run("drive", on_join="maybe"),  # type: ignore[arg-type]
    "robots is 5": lambda swarm: swarm.stop(5),  # type: ignore[arg-type]
    "robots is b'r1'": lambda swarm: swarm.run("drive", b"r1"),  # type: ignore[arg-type]
    "labels is": lambda swarm: swarm.run("drive", labels=[None]),  # type: ignore[list-item]
    "parameters are": lambda swarm: swarm.run("drive", params="a=1"),  # type: ignore[arg-type]
    "parameters are {1": lambda swarm: swarm.param({1: 0.1}),  # type: ignore[dict-item]
    "64 bits": lambda swarm: swarm.param({"speed": 10**30}),
    "seconds is '3'": lambda swarm: swarm.run("drive", seconds="3"),  # type: ignore[arg-type]
    "seconds is nan": lambda swarm: list(swarm.states(seconds=math.nan)),
    "at is -1": lambda swarm: swarm.run("drive", at=-1),
    "lease is inf": lambda swarm: swarm.run("drive", lease=math.inf),
    "lease: .* most": lambda swarm: swarm.run("drive", lease=4000.0),
    "canary_time is nan": lambda swarm: swarm.run("drive", canary=1, canary_time=math.nan),
    "canary_time is -1": lambda swarm: swarm.run("drive", canary=1, canary_time=-1.0),
    "since is 'x'": lambda swarm: list(swarm.events(since="x")),  # type: ignore[arg-type]
    "timeout is nan": lambda swarm: swarm.wait("state=idle", timeout=math.nan),
    "timeout is 0": lambda swarm: swarm.stop(timeout=0),
    "needs a condition": lambda swarm: swarm.wait([]),
    "conditions is": lambda swarm: swarm.wait(3),  # type: ignore[arg-type]
    "conditions foo": lambda swarm: swarm.wait("foo"),
    "changes is": lambda swarm: swarm.label(3),  # type: ignore[arg-type]
    "robot is": lambda swarm: swarm.describe(["r1"]),  # type: ignore[arg-type]
    "robot is 7": lambda swarm: swarm.acceptance(7, answer=_yes),  # type: ignore[arg-type]
    "answer is 'y'": lambda swarm: swarm.acceptance("r1", answer="y"),  # type: ignore[arg-type]
    "rows is 5": lambda swarm: swarm.acceptance("r1", 5, answer=_yes),  # type: ignore[arg-type]
    "rows is empty": lambda swarm: swarm.acceptance("r1", [], answer=_yes),
    "folder is 5": lambda swarm: swarm.acceptance("r1", folder=5, answer=_yes),  # type: ignore[arg-type]
    "frame takes": lambda swarm: swarm.frame(3),  # type: ignore[arg-type]
    "seeds is 5": lambda _: swarmd.connect(seeds=5),  # type: ignore[arg-type]
    "config is 5": lambda _: swarmd.connect(config=5),  # type: ignore[arg-type]
    "identity is 5": lambda _: swarmd.connect(identity=5),  # type: ignore[arg-type]
    "insecure is 'no'": lambda _: swarmd.connect(insecure="no"),  # type: ignore[arg-type]
}


@pytest.mark.parametrize("subject", WRONG)
def test_a_wrong_value_is_one_line_and_reaches_no_robot(subject: str) -> None:
    made = Counted()
    with pytest.raises(ConfigError, match=subject) as caught:
        WRONG[subject](Swarm(OperatorPool(made)))
    assert "\n" not in str(caught.value)
    assert made.made == 0


@pytest.mark.parametrize(
    ("values", "subject"),
    [
        ({"on_join": "run"}, "valid"),
        ({"valid": 3.0}, "on_join"),
        ({"lease": 0.5}, "lease"),
        ({"at": 90.0}, "at"),
        ({"canary_time": 3.0}, "canary"),
        ({"at": 3.0, "lease": 3.0}, "together"),
    ],
)
def test_values_of_a_run_that_do_not_go_together(values: dict[str, Any], subject: str) -> None:
    with pytest.raises(ConfigError, match=subject):
        Run(pattern="drive", **values).check()
    for wrong in (0, True, 1.5):
        with pytest.raises(ConfigError):
            choose_canaries(wrong, ["r1", "r2"])  # type: ignore[arg-type]


def test_a_request_whose_caller_has_gone_is_not_sent(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    cancelled = threading.Event()

    def members(**_: object) -> MembersView:
        cancelled.set()  # during the look
        return MembersView({"r1": make_member("r1")})

    operator = SimpleNamespace(
        settings=NetworkSettings(swarm="s"),
        identity=None,
        notices=[],
        members=members,
        close=lambda: None,
    )
    pool = OperatorPool(lambda: cast("Operator", operator))
    swarm = Swarm(pool, cancelled=cancelled)
    asks: list[Callable[[], object]] = [lambda: swarm.run("drive"), swarm.reset, swarm.undo]
    for ask in asks:
        cancelled.clear()
        with pytest.raises(SwarmError, match="not sent"):
            ask()
    cancelled.clear()
    assert swarm.members().alive == ("r1",)


def test_a_verb_that_follows_robots_tells_whom_it_waits_for() -> None:
    told = list[str]()
    session = Session(cast("Operator", None), tell=told.append)
    session.tell_awaited(MembersView({"r1": make_member("r1")}), Targets(("r*", "r2")))
    session.tell_awaited(MembersView({}), Targets())
    assert told == ["no robot 'r2'; there are: r1; waits for it", "no robot is heard yet"]


def test_what_robots_send_is_text_in_a_page() -> None:
    member = make_member("r1", reason=None, detail="<b>", pattern="<script>")
    shown = Members(MembersView({"r1": member}), {"r1": (1.0, 2.0, 0.5), "<r2>": (0.0, 0.0, 0.0)})
    page = shown._repr_html_()
    assert "<svg" in page
    assert "&lt;r2&gt;" in page
    assert "<script>" not in page
    assert "<svg" not in Members(MembersView({"r1": member}))._repr_html_()
    assert str(shown).splitlines()[-1].startswith("# 1/1 alive")


def replied(robot: str, code: Code) -> Reply:
    return Reply(id="a", robot=robot, code=code)


@pytest.mark.parametrize(
    ("codes", "missing", "unlisted", "is_success"),
    [
        ([Code.APPLIED, Code.APPLIED], (), (), True),
        ([Code.APPLIED, Code.REFUSED], (), (), False),
        ([Code.REFUSED] * 7, (), (), False),
        ([Code.APPLIED], ("r9",), (), False),
        ([Code.APPLIED], (), ("r0",), False),  # further robots may exist
        ([], (), (), False),
    ],
)
def test_an_outcome_is_true_only_if_all_robots_applied_the_request(
    codes: list[Code], missing: tuple[str, ...], unlisted: tuple[str, ...], is_success: bool
) -> None:
    replies = {f"r{i}": replied(f"r{i}", code) for i, code in enumerate(codes)}
    assert bool(Outcome(replies, missing, unlisted=unlisted)) is is_success


def test_what_python_shows_of_a_value_is_one_short_line() -> None:
    member = make_member("r1", pattern="drive")
    members = Members(MembersView({"r1": member}))
    outcome = Outcome({f"r{i}": replied(f"r{i}", Code.REFUSED) for i in range(3)}, ("r9",))
    shown = [repr(one) for one in (member, members, members.describe("r1"), outcome)]
    assert [text for text in shown if "\n" in text or len(text) > 100] == []
    assert shown[-1] == "Outcome('4 targeted, 0 applied, 3 refused (r0, r1, r2), 1 no answer (r9)')"
    assert "r1" in shown[0]
    assert "1/1 alive" in shown[1]
    assert "r1" in shown[2]


@pytest.mark.parametrize(("pattern", "text"), [("levy_walk", "0.25 m"), ("gone", "0.25")])
def test_a_description_has_the_units_of_an_installed_pattern(pattern: str, text: str) -> None:
    member = make_member(pattern=pattern, report={"left": 0.25})
    described = Members(MembersView({"r1": member})).describe("r1")
    assert dict(dict(described.sections)["Report"]) == {"left": text}


def test_a_state_has_the_safe_command_with_its_speed_to_the_left() -> None:
    news: queue.Queue[RobotState] = queue.Queue()
    asked, safe = (0.4, 0.5, 0.6), (0.1, 0.2, -0.3)
    _put(news, make_status("r1"), Motion("r1", 5.0, 1.0, 2.0, 0.5, asked, safe, True))
    _put(news, make_status("r1"), None)
    one, unknown = news.get(), news.get()
    assert (one.linear, one.angular, one.lateral) == safe
    assert math.isnan(unknown.lateral)


def test_a_frame_has_a_row_for_each_state() -> None:
    pytest.importorskip("pandas")
    states = [
        RobotState(time=1e9, robot="r1", state=State.IDLE, reason=None, pattern=None),
        RobotState(
            time=1e9 + 1, robot="r1", state=State.RUNNING, reason=None, pattern="drive", x=1.0,
            readings={"battery": 0.5},
        ),
    ]  # fmt: skip
    table = Swarm(OperatorPool(Counted())).frame(states)
    assert list(table["state"]) == ["idle", "running"]
    assert list(table["reading.battery"].dropna()) == [0.5]
    with pytest.raises(ConfigError, match="RobotState"):
        Swarm(OperatorPool(Counted())).frame([1])  # type: ignore[list-item]
    assert table["time"].diff().iloc[1].total_seconds() == 1.0


async def test_the_loop_goes_on_while_a_thread_iterates_and_errors_come_in_their_place() -> None:
    def numbers() -> Generator[int, None, None]:
        yield from range(5000)  # more than may wait at a time
        raise SwarmError("the robots have left")

    items = from_thread(numbers, threading.Event())
    assert [await anext(items) for _ in range(5000)] == list(range(5000))
    with pytest.raises(SwarmError, match="left"):
        await anext(items)


async def test_an_iterator_that_is_left_tells_its_thread_to_end() -> None:
    cancelled, ended = threading.Event(), threading.Event()

    def endless() -> Generator[int, None, None]:
        try:
            while True:
                yield 1
        finally:
            ended.set()

    items = from_thread(endless, cancelled)
    assert await anext(items) == 1
    await items.aclose()
    assert cancelled.is_set()
    assert await asyncio.to_thread(ended.wait, 10.0)


async def test_closing_waits_for_a_cancelled_call_to_end() -> None:
    begun, closed, ended = threading.Event(), threading.Event(), threading.Event()

    def members(**_: object) -> MembersView:
        begun.set()
        assert closed.wait(10.0)
        time.sleep(0.1)  # as a stop takes time
        ended.set()
        return MembersView({})

    operator = SimpleNamespace(members=members, close=lambda: None)
    swarm = AsyncSwarm(Swarm(OperatorPool(lambda: cast("Operator", operator)), cancelled=closed))
    task = asyncio.create_task(swarm.members())
    assert await asyncio.to_thread(begun.wait, 10.0)
    task.cancel()
    with pytest.raises(asyncio.CancelledError):
        await task
    await swarm.close()  # else the program could end before its robots are stopped
    assert ended.is_set()


async def test_a_task_that_is_cancelled_at_an_iterator_leaves_no_task_in_the_loop() -> None:
    cancelled, begun = threading.Event(), threading.Event()

    def silent() -> Generator[int, None, None]:
        begun.set()
        cancelled.wait(10.0)
        yield 1

    before = asyncio.all_tasks()

    async def wait() -> int:
        return await anext(from_thread(silent, cancelled))

    waiting = asyncio.create_task(wait())
    assert await asyncio.to_thread(begun.wait, 10.0)
    waiting.cancel()
    with pytest.raises(asyncio.CancelledError):
        await waiting
    await asyncio.sleep(0)
    assert asyncio.all_tasks() == before
