"""Requests to light daemons: targets, repeats, refusals and silence."""

from __future__ import annotations

from itertools import pairwise

import pytest
from msgspec.structs import replace

from swarmd.core.clock import boottime, clock_id
from swarmd.core.messages import Code
from swarmd.core.verbs import RunRequest
from swarmd.network.operator.exit_codes import PARTIAL
from swarmd.network.operator.operator import Operator
from swarmd.network.operator.request_sender import REPEAT_PERIOD
from swarmd.network.settings import NetworkSettings
from tests.network.conftest import Robots


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
