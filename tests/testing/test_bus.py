"""The bus in memory keeps the rules of the one on the network."""

from __future__ import annotations

import asyncio

import pytest

from swarmd.codec import MAX_MESSAGE, Decoder, encode
from swarmd.keys import Key
from swarmd.messages import Condition, Member, Status, View
from swarmd.network.contract import Bus, Query
from swarmd.testing.bus import MemoryBus, MemoryMedium
from swarmd.testing.light import light_status

view_of = Decoder(View)


@pytest.fixture
def medium() -> MemoryMedium:
    return MemoryMedium(clock=lambda: 0.0)


@pytest.fixture
def a(medium: MemoryMedium) -> MemoryBus:
    return MemoryBus(medium, "a", "1")


@pytest.fixture
def b(medium: MemoryMedium, a: MemoryBus) -> MemoryBus:
    return MemoryBus(medium, "b", "1")


def conditions(bus: Bus) -> dict[str, Condition]:
    return {name: member.condition for name, member in bus.members.items()}


def test_they_meet_when_it_is_delivered(medium: MemoryMedium, a: Bus, b: Bus) -> None:
    assert conditions(a) == {}
    medium.deliver()
    assert conditions(a) == {"b": Condition.ALIVE}
    assert conditions(b) == {"a": Condition.ALIVE}


def test_messages_arrive_at_the_others_in_order(medium: MemoryMedium, a: Bus, b: Bus) -> None:
    heard: list[tuple[Key, bytes]] = []
    a.listen("msg", "*/*", lambda key, payload: heard.append((key, payload)))
    b.listen("msg", "*/*", lambda key, payload: heard.append((key, payload)))
    a.publish("msg", "vote/opinion", b"1")
    a.publish("msg", "vote/opinion", b"2")
    assert heard == []
    medium.deliver()
    key = Key("memory", "a", "msg", "vote/opinion")
    assert heard == [(key, b"1"), (key, b"2")]


def test_what_is_said_while_delivering_waits(medium: MemoryMedium, a: Bus, b: Bus) -> None:
    heard: list[bytes] = []
    b.listen("msg", "x/y", lambda key, payload: b.publish("msg", "x/y", b"echo"))
    a.listen("msg", "x/y", lambda key, payload: heard.append(payload))
    a.publish("msg", "x/y", b"")
    medium.deliver()
    assert heard == []
    medium.deliver()
    assert heard == [b"echo"]


def test_only_those_in_reach_hear(a: MemoryBus, b: MemoryBus, medium: MemoryMedium) -> None:
    heard: list[bytes] = []
    b.listen("msg", "x/y", lambda key, payload: heard.append(payload))
    medium.reaches = lambda sender, hearer: (sender, hearer) != ("a", "b")
    a.publish("msg", "x/y", b"")
    medium.deliver()
    assert heard == []


@pytest.mark.parametrize("key", ["**", "swarm/memory/*/msg/x/y", "swarm/other/b/msg/x/y"])
def test_strange_keys_are_dropped_and_counted(medium: MemoryMedium, a: Bus, key: str) -> None:
    heard: list[bytes] = []
    a.listen("msg", "x/y", lambda key, payload: heard.append(payload))
    medium.put(key, b"")
    medium.deliver()
    assert heard == []
    assert a.dropped == {"key": 1}


def test_oversized_messages_are_dropped_and_counted(medium: MemoryMedium, a: Bus) -> None:
    medium.put("swarm/memory/b/msg/x/y", bytes(MAX_MESSAGE + 1))
    medium.deliver()
    assert a.dropped == {"msg/x/y:oversized": 1}


def test_queries_reach_each_and_answers_may_come_later(
    medium: MemoryMedium, a: Bus, b: Bus
) -> None:
    held: list[Query] = []
    a.serve("control", "run", lambda query: query.reply(query.payload + b"!"))
    b.serve("control", "run", held.append)
    replies = medium.ask("control", "run", b"go")
    assert replies == {"a": b"go!"}
    held[0].reply(b"late")
    held[0].reply(b"twice")
    assert replies == {"a": b"go!", "b": b"late"}
    assert medium.ask("control", "run", b"go", robot="a") == {"a": b"go!"}


def test_an_estop_is_also_taken_as_a_put(medium: MemoryMedium, a: Bus) -> None:
    heard: list[bytes] = []
    a.serve("safety", "estop", lambda query: heard.append(query.payload))
    medium.put("swarm/memory/a/safety/estop", b"stop")
    medium.put("swarm/memory/a/control/run", b"no")
    medium.deliver()
    assert heard == [b"stop"]
    assert a.dropped == {"control/run:key": 1}


def test_views_tell_of_the_others(medium: MemoryMedium, a: Bus, b: Bus) -> None:
    medium.deliver()
    a.serve_view(lambda: light_status("a", "1"), ("a", "b", "c"))
    view = view_of(medium.ask("control", "members")["a"])
    assert view.roster == ("a", "b", "c")
    assert [member.robot for member in view.members] == ["b"]
    assert asyncio.run(b.ask("state", "status")) == [("a", encode(light_status("a", "1")))]


def test_statuses_are_told(medium: MemoryMedium, a: Bus, b: Bus) -> None:
    heard: list[Status] = []
    a.on_status(heard.append)
    b.publish("state", "status", encode(light_status("a", "1")))
    b.publish("state", "status", encode(light_status("b", "1")))
    medium.deliver()
    assert [status.robot for status in heard] == ["b"]


def test_leaving_and_vanishing(medium: MemoryMedium, a: Bus, b: Bus) -> None:
    news: list[Member] = []
    a.on_member(news.append)
    medium.deliver()
    b.publish("state", "status", encode(light_status("b", "1", has_left=True)))
    b.close()
    medium.deliver()
    c = MemoryBus(medium, "c", "1")
    medium.deliver()
    c.close()
    medium.deliver()
    assert conditions(a) == {"b": Condition.LEFT, "c": Condition.FAILED}
    assert [member.robot for member in news] == ["b", "b", "c", "c"]
    assert a.forget("c")
