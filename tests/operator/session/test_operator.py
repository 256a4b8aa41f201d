"""The operator's side against light daemons: real sessions, real processes."""

from __future__ import annotations

import pytest
from msgspec.structs import replace

from swarmd.core.verbs import RunRequest
from swarmd.link.settings import NetworkSettings
from swarmd.operator.session.exit_codes import NO_TARGET
from swarmd.operator.session.operator import Operator
from tests.link.conftest import Robots
from tests.support.processes import wait_until


def test_a_swarm_without_daemons_is_an_empty_view(settings: NetworkSettings) -> None:
    with Operator(settings) as operator:
        assert operator.members(timeout=0.2).members == {}
        assert operator.request(RunRequest, {}, pattern="x").exit_code == NO_TARGET
        outcome = operator.send_stop("stop", timeout=0.2)
    assert (outcome.exit_code, outcome.reached) == (NO_TARGET, 0)


@pytest.mark.long
@pytest.mark.parametrize("needs_status", [True, False])
def test_a_robot_that_died_since_the_last_look_has_not_answered(
    settings: NetworkSettings, robots: Robots, needs_status: bool
) -> None:
    swarm = robots("a", "b")
    with Operator(settings) as operator:
        first = operator.members(needs_status=needs_status, timeout=30.0)
        assert (first.answered, first.missing) == (frozenset("ab"), ())
        swarm.call(swarm["b"].vanish)
        again = operator.members(needs_status=needs_status)
        assert (again.answered, again.missing) == (frozenset("a"), ("b",))


def test_other_swarms_can_be_seen(settings: NetworkSettings, robots: Robots) -> None:
    robots("a")
    with Operator(replace(settings, swarm="another")) as operator:
        wait_until(lambda: settings.swarm in operator.swarms(), "the other swarm answers")
