"""Requests to light daemons: targets, repeats, refusals and silence."""

from __future__ import annotations

from itertools import pairwise

import pytest
from msgspec.structs import replace

from swarmd.core.clock import boottime, clock_id
from swarmd.core.errors import RequestError
from swarmd.core.messages import Code
from swarmd.core.verbs import AnyRequest, ResetRequest, ResumeRequest, RunRequest
from swarmd.link.settings import NetworkSettings
from swarmd.operator.session import senders as request_sender
from swarmd.operator.session.exit_codes import FAILED, PARTIAL, TIMEOUT
from swarmd.operator.session.operator import Operator
from swarmd.operator.session.senders import REPEAT_PERIOD
from tests.link.conftest import Robots
from tests.support.processes import wait_until


def test_a_request_reaches_its_targets_alone(settings: NetworkSettings, robots: Robots) -> None:
    swarm = robots("a", "b", "c")
    with Operator(settings, name="anna@laptop") as operator:
        targets = operator.members().epochs(["a", "b"])
        outcome = operator.request(RunRequest, targets, pattern="attraction")
    assert outcome.line == "2 targeted, 2 applied"
    [request] = swarm["a"].different_requests
    assert isinstance(request, RunRequest)
    assert request == RunRequest(
        id=request.id,
        operator="anna@laptop",
        targets=targets,
        pattern="attraction",
        age=request.age,
        planned=request.planned,
        clock=clock_id(),
        issued=request.issued,
        issued_at=request.issued_at,
    )
    [other] = swarm["b"].different_requests
    assert isinstance(other, RunRequest)
    assert replace(other, age=request.age) == request
    assert swarm["c"].requests == []


@pytest.mark.long
def test_each_copy_of_a_request_counts_from_when_it_was_issued(
    settings: NetworkSettings, robots: Robots
) -> None:
    """Not from the look or the first copy; an answer comes to the third copy."""
    swarm = robots("a", answer=lambda request: Code.APPLIED if request.age > 7.9 else None)
    issued = boottime() - 7.0
    with Operator(settings) as operator:
        targets = operator.members().epochs(["a"])
        outcome = operator.request(RunRequest, targets, issued=issued, pattern="x")
    assert outcome.line == "1 targeted, 1 applied"
    requests = [one for one in swarm["a"].requests if isinstance(one, RunRequest)]
    assert len(requests) > 1
    assert {one.issued for one in requests} == {issued}
    assert {one.clock for one in requests} == {clock_id()}
    assert all(before.age < after.age for before, after in pairwise(requests))
    assert requests[0].age >= 7.0


def test_a_request_declares_the_time_for_which_its_operator_worked(
    settings: NetworkSettings, robots: Robots
) -> None:
    """Looks and the time until a start count, and so do 3 s of a program's start; no pause does."""
    swarm = robots("a")
    with Operator(settings) as operator:
        ago = 5.0  # s: a machine may be young, and no order was typed before its boot
        typed = boottime() - ago
        look = operator.members()
        operator.request(RunRequest, look.epochs(["a"]), issued=typed, pattern="x")
        took = boottime() - typed - ago
        operator.request(RunRequest, look.epochs(["a"]), issued=typed, ahead=20.0, pattern="x")
        operator.request(RunRequest, look.epochs(["a"]), pattern="x")
    sent = swarm["a"].different_requests
    first, second, third = [one for one in sent if isinstance(one, RunRequest)]
    assert 3.0 <= first.planned <= 3.0 + took
    assert 20.0 <= second.planned - first.planned <= 20.0 + took
    assert third.planned <= third.age  # from a call, which states no time, its age counts anew


def test_no_start_is_sent_after_a_standstill(settings: NetworkSettings, robots: Robots) -> None:
    """docs/evidence/motion.md: a gap of more than 1 s in the loop of its program ends a start."""
    swarm = robots("a")
    with Operator(settings) as operator:
        targets = operator.members().epochs(["a"])
        now = boottime()
        operator.loops.begin(now - 10.0)
        operator.loops.turn(now, pause=8.9)
        with pytest.raises(RequestError) as error:
            operator.request(RunRequest, targets, issued=now - 10.0, pattern="x")
        assert error.value.exit_code == FAILED
        with pytest.raises(RequestError):
            operator.request(ResumeRequest, targets, issued=now - 10.0)
        assert swarm["a"].requests == []
        assert operator.request(ResetRequest, targets, issued=now - 10.0).exit_code == 0
        assert operator.request(RunRequest, targets, issued=boottime(), pattern="x").exit_code == 0


def test_a_start_is_not_repeated_after_a_standstill(
    settings: NetworkSettings, robots: Robots, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The clock goes on by 40 s while the sender waits for a reply."""
    ahead = [0.0]

    def no_answer(request: AnyRequest) -> None:
        ahead[0] = 40.0

    swarm = robots("a", answer=no_answer)
    with Operator(settings) as operator:
        targets = operator.members().epochs(["a"])
        now = boottime
        monkeypatch.setattr(request_sender, "boottime", lambda: now() + ahead[0])
        outcome = operator.request(RunRequest, targets, issued=now(), timeout=300.0, pattern="x")
    assert len(swarm["a"].requests) == 1
    assert (outcome.missing, outcome.exit_code) == (("a",), TIMEOUT)
    assert len(outcome.warnings) == 1


def test_a_request_waits_for_links_that_are_not_up_when_it_begins(
    settings: NetworkSettings, robots: Robots
) -> None:
    swarm = robots("a", "b", "c")
    with Operator(settings) as operator:
        view = operator.members(needs_status=False)
        targets = view.epochs(["a", "b"])
        outcome = operator.request(RunRequest, targets, pattern="x", least_timeout=20.0)
    assert view.missing == ()
    assert targets["a"] == swarm["a"].status().epoch
    assert outcome.line == "2 targeted, 2 applied"
    assert len(swarm["a"].different_requests) == 1
    assert swarm["c"].requests == []


def test_a_reply_that_came_during_a_standstill_counts(
    settings: NetworkSettings, robots: Robots, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The reply is handed over once the loop of the sender has seen its gap."""
    ahead = [0.0]
    with Operator(settings) as operator:

        def late_answer(request: AnyRequest) -> Code:
            ahead[0] = 40.0
            wait_until(lambda: operator.loops.stood(0.0) > 0.0, "the gap is noticed")
            return Code.APPLIED

        robots("a", answer=late_answer)
        targets = operator.members().epochs(["a"])
        now = boottime
        monkeypatch.setattr(request_sender, "boottime", lambda: now() + ahead[0])
        outcome = operator.request(RunRequest, targets, issued=now(), timeout=300.0, pattern="x")
    assert (outcome.missing, outcome.exit_code, outcome.warnings) == ((), 0, ())


@pytest.mark.long
def test_refusals_and_silence_are_named(settings: NetworkSettings, robots: Robots) -> None:
    robots("a")
    robots("b", answer=lambda request: Code.REFUSED)
    silent = robots("c", answer=lambda request: None)["c"]
    with Operator(settings) as operator:
        targets = operator.members().epochs(["a", "b", "c"])
        outcome = operator.request(
            RunRequest,
            {**targets, "d": None},
            pattern="x",
            timeout=20.0,
            is_ended=lambda: len(silent.requests) > 2,  # the others were asked as often
        )
    assert outcome.line == "4 targeted, 1 applied, 1 refused (b), 2 no answer (c, d)"
    assert outcome.exit_code == PARTIAL


@pytest.mark.long
def test_a_request_is_repeated_to_robots_without_a_reply(
    settings: NetworkSettings, robots: Robots
) -> None:
    swarm = robots("a")
    deaf = robots("deaf", answer=lambda request: Code.APPLIED if count() > 2 else None)

    def count() -> int:
        return len(deaf["deaf"].requests)

    with Operator(settings) as operator:
        targets = operator.members().epochs(["a", "deaf"])
        outcome = operator.request(RunRequest, targets, pattern="x", timeout=20.0)
    assert outcome.line == "2 targeted, 2 applied"
    [request] = swarm["a"].different_requests
    assert isinstance(request, RunRequest)
    repeats = [one for one in deaf["deaf"].requests if isinstance(one, RunRequest)]
    assert [replace(one, age=request.age) for one in repeats[:3]] == [request] * 3
    ages = [one.age for one in repeats]
    assert ages == sorted(ages)
    assert ages[2] >= 2 * REPEAT_PERIOD
