"""The operator's side against light daemons: real sessions, real processes."""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterator
from typing import Any

import pytest
import zenoh
from msgspec.structs import replace

from swarmd.core.codec import Decoder
from swarmd.core.messages import Code, Epoch, EstopRequest, Presence, ResetRequest, RunRequest
from swarmd.network.operator import Operator, StopVerb, operator_name
from swarmd.network.outcome import NO_TARGET, PARTIAL
from swarmd.network.session import open_session
from swarmd.network.settings import NetworkSettings
from tests.support.fake_daemon import FakeSwarm

Robots = Callable[..., FakeSwarm]

decode = Decoder(EstopRequest)


@pytest.fixture
def robots(settings: NetworkSettings) -> Iterator[Robots]:
    """Starts light daemons on a loop of their own; all are gone after the test."""
    made: list[FakeSwarm] = []

    def start(*names: str, **options: Any) -> FakeSwarm:
        swarm = FakeSwarm(settings, names, **options)
        made.append(swarm)
        return swarm

    yield start
    for swarm in made:
        swarm.close()


def test_members_come_with_their_own_status(settings: NetworkSettings, robots: Robots) -> None:
    swarm = robots("a", "b", "c")
    with Operator(settings) as operator:
        view = operator.members()
    assert view.alive == ("a", "b", "c")
    assert view.answered == {"a", "b", "c"}
    assert view.epochs(["b"]) == {"b": Epoch(instance=swarm["b"].instance, revision=0)}


def test_a_swarm_without_daemons_is_an_empty_view(settings: NetworkSettings) -> None:
    with Operator(settings) as operator:
        assert operator.members().members == {}
        assert operator.request(RunRequest, {}, pattern="x").exit_code == NO_TARGET
        assert operator.halt("stop", timeout=0.2).exit_code == NO_TARGET


def test_those_that_left_or_failed_are_listed(settings: NetworkSettings, robots: Robots) -> None:
    swarm = robots("a", "polite", "rude")
    swarm.call(swarm["polite"].leave)
    swarm.call(swarm["rude"].vanish)
    swarm.until(lambda: swarm["a"].bus.members["rude"].presence is Presence.FAILED)
    with Operator(settings) as operator:
        members = operator.members().members
    assert {name: member.presence for name, member in members.items()} == {
        "a": Presence.ALIVE,
        "polite": Presence.LEFT,
        "rude": Presence.FAILED,
    }


def test_a_request_reaches_its_targets_alone(settings: NetworkSettings, robots: Robots) -> None:
    swarm = robots("a", "b", "c")
    with Operator(settings, name="anna@laptop") as operator:
        targets = operator.members().epochs(["a", "b"])
        outcome = operator.request(RunRequest, targets, pattern="attraction")
    assert outcome.line == "2 targeted, 2 applied"
    [request] = swarm["a"].requests
    assert request == RunRequest(
        id=request.id, operator="anna@laptop", targets=targets, pattern="attraction"
    )
    assert swarm["b"].requests == [request]
    assert swarm["c"].requests == []


def test_refusals_and_silence_are_named(settings: NetworkSettings, robots: Robots) -> None:
    robots("a")
    robots("b", answer=lambda request: Code.REFUSED)
    robots("c", answer=lambda request: None)
    with Operator(settings) as operator:
        targets = operator.members().epochs(["a", "b", "c"])
        outcome = operator.request(RunRequest, targets, pattern="x", timeout=0.3, absent=["d"])
    assert outcome.line == "4 targeted, 1 applied, 1 refused (b), 2 no answer (c, d)"
    assert outcome.exit_code == PARTIAL


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
    [request] = swarm["a"].requests
    assert deaf["deaf"].requests == [request] * 3


@pytest.mark.parametrize("verb", ["stop", "estop"])
def test_a_stop_reaches_all_without_waiting_for_members(
    settings: NetworkSettings, robots: Robots, verb: StopVerb
) -> None:
    swarm = robots("a", "b", "c")
    with Operator(settings) as operator:
        outcome = operator.halt(verb, reason="test")
    assert outcome.line == "3 targeted, 3 applied"
    for name in "abc":
        heard = swarm[name].requests
        assert {(one.verb, one.targets) for one in heard} == {(verb, None)}
        assert len({one.id for one in heard}) == 1
        assert all(one.reason == "test" for one in heard if isinstance(one, EstopRequest))


def test_an_estop_is_also_put_on_each_robots_own_key(
    settings: NetworkSettings, robots: Robots
) -> None:
    swarm = robots("a", "b")
    ear = open_session(settings)
    heard = ear.declare_subscriber(
        f"swarm/{settings.swarm}/*/safety/estop", zenoh.handlers.FifoChannel(64)
    )
    try:
        with Operator(settings, roster=["a", "b", "lost"]) as operator:
            operator.halt("estop", timeout=1.0)
        keys: dict[str, str] = {}
        while keys.keys() != {"a", "b", "lost"}:
            sample = heard.recv()
            request = decode(sample.payload.to_bytes())
            keys[str(sample.key_expr).split("/")[2]] = request.id
    finally:
        ear.close()
    assert set(keys.values()) == {swarm["a"].requests[0].id}


def test_a_stop_is_repeated_until_all_acked(settings: NetworkSettings, robots: Robots) -> None:
    swarm = robots("a")
    deaf = robots("deaf", answer=lambda request: Code.APPLIED if count() > 5 else None)

    def count() -> int:
        return len(deaf["deaf"].requests)

    with Operator(settings) as operator:
        outcome = operator.halt("stop", timeout=20.0)
    assert outcome.line == "2 targeted, 2 applied"
    assert len(swarm["a"].requests) < count()


def test_deaf_and_failed_robots_are_named_by_a_stop(
    settings: NetworkSettings, robots: Robots
) -> None:
    swarm = robots("a", "lost")
    robots("deaf", answer=lambda request: None)
    swarm.call(swarm["lost"].vanish)
    swarm.until(lambda: swarm["a"].bus.members["lost"].presence is Presence.FAILED)
    with Operator(settings) as operator:
        outcome = operator.halt("estop", timeout=0.5)
    assert outcome.line == "3 targeted, 1 applied, 2 no answer (deaf, lost)"
    assert outcome.exit_code == PARTIAL


def test_a_stop_reaches_a_robot_that_joins_meanwhile(
    settings: NetworkSettings, robots: Robots
) -> None:
    robots("a")
    starting = threading.Thread(target=lambda: robots("late"))
    with Operator(settings, roster=["late"]) as operator:
        starting.start()
        outcome = operator.halt("estop", timeout=20.0)
        starting.join()
    assert outcome.line == "2 targeted, 2 applied"


def test_other_swarms_can_be_seen(settings: NetworkSettings, robots: Robots) -> None:
    robots("a")
    with Operator(replace(settings, swarm="another")) as operator:
        assert settings.swarm in operator.swarms()


def test_an_operator_name_that_is_no_utf8_is_mended(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("LOGNAME", "\udcff\udcfe" + "x" * 300)
    name = operator_name()
    assert name.startswith("??x")
    assert len(name.encode()) == 128


@pytest.mark.parametrize(
    ("reason", "kept"), [("ä" * 300, "ä" * 256), ("out\udcff of paint", "out? of paint")]
)
@pytest.mark.parametrize("verb", ["estop", "reset"])
def test_a_reason_that_cannot_be_sent_is_mended_and_never_refused(
    settings: NetworkSettings, robots: Robots, verb: str, reason: str, kept: str
) -> None:
    swarm = robots("a")
    with Operator(settings, name="\udcff" * 200) as operator:
        if verb == "reset":
            epochs = operator.members().epochs(["a"])
            outcome = operator.request(ResetRequest, epochs, reason=reason)
        else:
            outcome = operator.halt("estop", reason=reason)
    assert outcome.line == "1 targeted, 1 applied"
    request = swarm["a"].requests[-1]
    assert isinstance(request, EstopRequest | ResetRequest)
    assert (request.operator, request.reason) == ("?" * 128, kept)
