"""Commands of pages: what waits delays no stop, starts nothing late, and is told how it ended."""

from __future__ import annotations

import asyncio
import json
import threading
from collections.abc import Callable, Collection, Mapping
from contextlib import AbstractContextManager, nullcontext
from pathlib import Path
from typing import Any, cast

import pytest
from websockets.asyncio.client import connect

from swarmd.core.messages import Code, Reply
from swarmd.link.settings import NetworkSettings
from swarmd.operator.client.hand_over import HAND_OVER
from swarmd.operator.client.operator_pool import MAX_REQUESTS
from swarmd.operator.session.members_view import MembersView
from swarmd.operator.session.operator import Operator
from swarmd.operator.session.outcome import Outcome
from swarmd.operator.view.commander import LiveCommander
from swarmd.operator.view.source import CommandProgress
from tests.operator.view.test_server import frame, serving, socket_of
from tests.support.operator_threads import is_closing
from tests.support.processes import CAP, wait_until
from tests.support.statuses import make_member

APPLIED = Outcome({"r1": Reply(id="1", robot="r1", code=Code.APPLIED)})


class Hanging:
    """An operator whose requests wait for `go_on`; `sent` counts them."""

    def __init__(self) -> None:
        self.go_on = threading.Event()
        self.sent = 0
        self.notices: list[str] = []
        self.settings = NetworkSettings(swarm="s")
        self.heard = ["r1", "r2"]
        self.expected: set[str] = set()

    def __call__(self) -> AbstractContextManager[Operator]:
        return nullcontext(cast("Operator", self))

    name, identity = "anna@laptop", None

    def expect(self, names: Collection[str]) -> None:
        self.expected |= set(names)

    def members(self, **_: Any) -> MembersView:
        members = {name: make_member(name, labels=("red",)) for name in self.heard}
        return MembersView(members, roster=frozenset(self.expected), goal_generation=4)

    seen = members

    def swarms(self) -> list[str]:
        return []

    def request(self, kind: type, targets: Mapping[str, Any], **_: Any) -> Outcome:
        self.sent += 1
        self.go_on.wait()
        return APPLIED

    def send_stop(self, verb: str, **_: Any) -> Outcome:
        return APPLIED


@pytest.fixture(autouse=True)
def cache(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A look keeps the names of robots for completion. A loaded machine makes gaps."""
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    monkeypatch.setattr("swarmd.operator.session.clocks.MAX_INPUT_GAP", CAP)


def commander(operator: object) -> LiveCommander:
    return LiveCommander(cast("Callable[[], Operator]", operator))


async def answer(one: LiveCommander, verb: str, **fields: Any) -> CommandProgress:
    told: list[CommandProgress] = []
    await one.act(verb, {"targets": ["r1"], "pattern": "drive", **fields}, told.append)
    assert told[-1].is_final
    return told[-1]


async def test_requests_that_wait_delay_no_stop_and_keep_no_other_for_later() -> None:
    operator = Hanging()
    one = commander(operator)
    waiting = [asyncio.create_task(answer(one, "run")) for _ in range(MAX_REQUESTS)]
    await asyncio.to_thread(wait_until, lambda: operator.sent == MAX_REQUESTS, "all wait")
    try:
        assert "not sent" in (await answer(one, "run")).line
        for verb in ("stop", "estop"):
            assert (await answer(one, verb, targets=None)).is_good
        assert is_closing()  # the program ends without waiting for them
        assert all(thread.daemon for thread in threading.enumerate() if "commanding" in thread.name)
    finally:
        operator.go_on.set()
    assert all(told.is_good for told in await asyncio.gather(*waiting))
    assert operator.sent == MAX_REQUESTS


async def test_a_command_that_fails_is_told_whatever_the_reason() -> None:
    def broken() -> Operator:
        raise RuntimeError("no threads left")

    told: list[CommandProgress] = []
    with pytest.raises(RuntimeError):
        await commander(broken).act("estop", {"targets": None}, told.append)
    assert [(one.line, one.is_good, one.is_final) for one in told] == [
        ("estop: no threads left", False, True)
    ]


@pytest.mark.parametrize("verb", ["run", "stop", "estop", "reset"])
@pytest.mark.parametrize("targets", [[], "r1", 7])
async def test_a_command_to_no_robot_is_refused(verb: str, targets: object) -> None:
    told = await answer(commander(Hanging()), verb, targets=targets)
    assert not told.is_good
    assert told.replies == []


class Noting(Hanging):
    """Two robots, and the requests to them."""

    def __init__(self) -> None:
        super().__init__()
        self.requests: list[tuple[tuple[str, ...], dict[str, Any]]] = []

    def request(
        self,
        kind: type,
        targets: Mapping[str, Any],
        *,
        issued: float = 0.0,
        timeout: None = None,
        **fields: Any,
    ) -> Outcome:
        self.requests.append((tuple(targets), fields))
        return APPLIED


@pytest.mark.parametrize(("names", "targets"), [(["r1"], ("r1",)), (["r1", "r2"], ())])
async def test_a_run_of_a_page_sets_a_goal(names: list[str], targets: tuple[str, ...]) -> None:
    operator = Noting()
    assert (await answer(commander(operator), "run", targets=names)).is_good
    goal = operator.requests[0][1]["goal"]
    assert (goal.generation, goal.targets, goal.pattern) == (5, targets, "drive")


async def test_a_page_changes_labels() -> None:
    operator = Noting()
    await answer(commander(operator), "label", labels="+fast -red")
    assert operator.requests == [(("r1",), {"labels": ("fast",)})]
    told = await answer(commander(operator), "label", labels="fast")
    assert not told.is_good
    assert "+LABEL" in told.line


@pytest.mark.parametrize("verb", ["run", "reset", "label", "param"])
async def test_robots_that_nobody_hears_are_named(verb: str) -> None:
    operator = Noting()
    operator.heard = []
    told = await answer(commander(operator), verb, targets=["r1", "r7"], labels="+fast")
    assert (told.missing, told.is_good, operator.requests) == (["r1", "r7"], False, [])
    assert "no daemon of swarm 's' can be reached" in told.line


async def test_a_robot_that_the_page_shows_and_nobody_hears_is_asked_all_the_same() -> None:
    operator = Noting()
    await answer(commander(operator), "run", targets=["r1", "r2", "r7"])
    ((names, fields),) = operator.requests
    assert (names, fields["goal"].targets) == (("r1", "r2", "r7"), ())


class Slow(Noting):
    """Its looks and stops wait for `go_on`."""

    def __init__(self) -> None:
        super().__init__()
        self.begun = threading.Semaphore(0)
        self.stops: list[str] = []

    def members(self, **_: Any) -> MembersView:
        self.begun.release()
        assert self.go_on.wait(CAP)
        return super().members()

    def send_stop(self, verb: str, **_: Any) -> Outcome:
        self.begun.release()
        assert self.go_on.wait(CAP)
        self.stops.append(verb)
        return APPLIED


async def test_a_request_whose_browser_has_gone_is_not_sent_and_a_stop_is() -> None:
    operator = Slow()
    commands: list[dict[str, Any]] = [
        {"verb": "run", "targets": ["r1"], "pattern": "drive"},
        {"verb": "stop"},
    ]
    async with serving(commander=commander(operator)) as (server, address):
        try:
            for command in commands:
                async with connect(socket_of(address), max_size=None) as page:
                    await frame(page)
                    act = {"kind": "act", "id": "1", "seen": server.frames, **command}
                    await page.send(json.dumps(act))
                    assert await asyncio.to_thread(operator.begun.acquire, timeout=CAP)
                    page.transport.abort()
            await asyncio.to_thread(wait_until, lambda: server.clients == 0, "they have gone")
        finally:
            operator.go_on.set()
        await asyncio.to_thread(wait_until, lambda: not busy(), "both have ended")
    assert (operator.requests, operator.stops) == ([], ["stop"])


def busy() -> list[str]:
    """The threads that carry commands out."""
    return [one.name for one in threading.enumerate() if one.name == HAND_OVER]
