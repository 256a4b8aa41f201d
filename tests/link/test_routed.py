"""Profile routed: robots and operators as clients of routers, one of which dies."""

from __future__ import annotations

import json
import time
from collections.abc import Iterator
from pathlib import Path

import pytest
import zenoh

from swarmd.core.errors import ConfigError, NetworkError
from swarmd.core.keys import CONTROL, build
from swarmd.core.messages import Presence
from swarmd.core.verbs import RunRequest
from swarmd.link.carriers.session import open_with, operator_options
from swarmd.link.datagram import Stop
from swarmd.link.settings import NetworkSettings
from swarmd.operator.cli.keys import router_configuration
from swarmd.operator.session.operator import Operator
from tests.support.fake_daemon import FakeDaemon, FakeSwarm
from tests.support.keys import SwarmKeys
from tests.support.processes import free_endpoint, unique_swarm, wait_until
from tests.support.router import Router

pytestmark = pytest.mark.integration

ROBOTS = ("r1", "r2", "r3")


@pytest.fixture
def routers() -> Iterator[list[Router]]:
    """Two routers with a link to each other."""
    first, second = free_endpoint(), free_endpoint()
    made = [Router(first), Router(second, first)]
    yield made
    for router in made:
        router.kill()


def routed(routers: list[Router]) -> NetworkSettings:
    endpoints = tuple(router.endpoint for router in routers)
    return NetworkSettings(profile="routed", swarm=unique_swarm(), routers=endpoints)


def asked(robot: FakeDaemon) -> int:
    """How many requests it has had, without stops, which are repeated and may come late."""
    return sum(not isinstance(one, Stop) for one in robot.requests)


def answered(settings: NetworkSettings) -> set[str]:
    with Operator(settings, name="anna") as operator:
        return set(operator.members().answered)


def test_a_router_with_keys_lets_each_name_do_what_its_role_may(tmp_path: Path) -> None:
    swarm = unique_swarm()
    keys = SwarmKeys(tmp_path, swarm, ROBOTS, operators=["alice"], viewers=["eve", "router"])
    endpoint = free_endpoint()
    configuration = router_configuration(keys["router"], endpoint.replace("tcp/", "tls/"))
    (tmp_path / "router.json").write_text(json.dumps(configuration))
    router = Router(str(tmp_path / "router.json"))
    settings = NetworkSettings(profile="routed", swarm=swarm, routers=(endpoint,))
    robots = FakeSwarm(settings, ROBOTS, keys=keys)
    thief = open_with(operator_options(settings, (), keys["r2"]), "a thief")
    try:
        with Operator(settings, identity=keys["alice"]) as operator:
            wait_until(lambda: operator.members().answered == set(ROBOTS), "all answer")
            view = operator.members()
            outcome = operator.request(RunRequest, view.epochs(ROBOTS), pattern="x")
            assert outcome.applied == ROBOTS
            operator.take_identity(keys["alice"])  # as a newer roster does
            wait_until(lambda: operator.members().answered == set(ROBOTS), "all answer again")
            assert operator.send_stop("stop").applied == ROBOTS
        with Operator(settings, identity=keys["eve"]) as viewer:
            wait_until(lambda: viewer.members().answered == set(ROBOTS), "all answer the viewer")
            with pytest.raises(ConfigError, match="viewer"):
                viewer.request(RunRequest, view.epochs(ROBOTS), pattern="x")
        wait_until(lambda: bool(list(thief.info.routers_zid())), "the thief has a link")
        before = asked(robots["r1"])
        for asker in ("alice", "r2"):
            key = build(swarm, "r1", CONTROL, "members", asker)
            assert list(thief.get(key, target=zenoh.QueryTarget.ALL, timeout=2.0)) == []
        assert asked(robots["r1"]) == before
    finally:
        thief.close()
        robots.close()
        router.kill()


def test_robots_behind_routers_are_found_commanded_and_stopped(routers: list[Router]) -> None:
    settings = routed(routers)
    swarm = FakeSwarm(settings, ROBOTS)
    try:
        with Operator(settings, name="anna") as operator:
            wait_until(lambda: operator.members().answered == set(ROBOTS), "all answer")
            view = operator.members()
            outcome = operator.request(RunRequest, view.epochs(ROBOTS), pattern="drive")
            assert outcome.applied == ROBOTS
            for verb in ("stop", "estop"):
                assert operator.send_stop(verb).applied == ROBOTS
        alive = {"r2": Presence.ALIVE, "r3": Presence.ALIVE}
        r1 = swarm["r1"].network
        wait_until(
            lambda: {name: one.presence for name, one in r1.members.items()} == alive,
            "r1 hears both others",
        )
    finally:
        swarm.close()


def test_the_other_router_takes_over_when_one_dies(routers: list[Router]) -> None:
    settings = routed(routers)
    swarm = FakeSwarm(settings, ROBOTS)
    try:
        wait_until(lambda: answered(settings) == set(ROBOTS), "all answer")
        routers[0].kill()  # to which all are linked, since it is the first of the list
        began = time.monotonic()
        wait_until(lambda: answered(settings) == set(ROBOTS), "all answer by the other router")
        print(f"the other router took over after {time.monotonic() - began:.1f} s")
        with Operator(settings, name="anna") as operator:
            wait_until(lambda: operator.send_stop("estop").applied == ROBOTS, "all are stopped")
    finally:
        swarm.close()


def test_robots_that_start_before_their_router_are_found_later() -> None:
    endpoint = free_endpoint()
    settings = NetworkSettings(profile="routed", swarm=unique_swarm(), routers=(endpoint,))
    swarm = FakeSwarm(settings, ("r1",), is_awaited=False)
    router: Router | None = None
    try:
        with pytest.raises(NetworkError, match=endpoint):
            Operator(settings, name="anna")
        router = Router(endpoint)
        wait_until(lambda: answered(settings) == {"r1"}, "it answers")
    finally:
        swarm.close()
        if router is not None:
            router.kill()
