"""The bus over real sessions: what comes through, what is dropped and counted."""

from __future__ import annotations

import asyncio
import time
from collections.abc import Awaitable, Callable, Iterator

import msgspec
import pytest
import zenoh

from swarmd.core.codec import MAX_CONTROL, Decoder, encode
from swarmd.core.messages import Member, PeerView, Presence, Status
from swarmd.core.verbs import MembersQuery
from swarmd.link.carriers.bus import Query, ZenohBus, without_mapping
from swarmd.link.carriers.inbound_queue import CAPACITY, DropCounter
from swarmd.link.carriers.session import open_listening, open_with
from swarmd.link.settings import NetworkSettings
from tests.support.fake_daemon import light_status

Until = Callable[[Callable[[], bool]], Awaitable[None]]

view_of = Decoder(PeerView)
WILD = ("**", "*/*/run/*", "me/control/*/eve", "*/control/run/*", "*/control/*/*", "me/**")
OFF = {"scouting/multicast/enabled": False, "scouting/gossip/enabled": False}


class BusRig:
    """One bus, and one foreign session that has a link to it."""

    def __init__(self, session: zenoh.Session, foreign: zenoh.Session, swarm: str) -> None:
        self.drops = DropCounter()
        self.bus = ZenohBus(session, swarm=swarm, robot="me", drops=self.drops)
        self.foreign = foreign
        self._swarm = swarm

    def key(self, rest: str) -> str:
        return f"swarm/{self._swarm}/{rest}"

    async def serve(self, handler: Callable[[Query], None]) -> None:
        """Return when a query has been answered."""
        self.bus.serve("control", "run", handler)
        while not await self.get("me/control/run/eve"):
            continue

    async def get(self, rest: str, payload: bytes = b"") -> list[tuple[str, bytes]]:
        def asked() -> list[tuple[str, bytes]]:
            replies = self.foreign.get(
                self.key(rest),
                target=zenoh.QueryTarget.ALL,
                consolidation=zenoh.ConsolidationMode.NONE,
                timeout=5.0,
                payload=payload,
            )
            return [
                (str(reply.ok.key_expr), reply.ok.payload.to_bytes())
                for reply in replies
                if reply.ok is not None
            ]

        return await asyncio.to_thread(asked)


@pytest.fixture
def rig(runner: asyncio.Runner, settings: NetworkSettings) -> Iterator[BusRig]:
    session, endpoint = open_listening("tcp/127.0.0.1:0", OFF, "a test")
    foreign = open_with({**OFF, "listen/endpoints": [], "connect/endpoints": [endpoint]}, "a test")

    async def make() -> BusRig:
        return BusRig(session, foreign, settings.swarm)

    made = runner.run(make())
    yield made
    made.bus.close()
    session.close()
    foreign.close()


def echo(query: Query) -> None:
    query.reply(query.payload + b"!")


async def test_a_query_of_which_the_handler_raises_gets_no_answer(rig: BusRig) -> None:
    def fail_once(query: Query) -> None:
        if query.payload == b"fail":
            raise ValueError("a bug")
        query.reply(b"well")

    await rig.serve(fail_once)
    assert await rig.get("me/control/run/eve", b"fail") == []
    assert await rig.get("me/control/run/eve") != []
    assert rig.drops.counts() == {"control/run:failed": 1}


@pytest.mark.parametrize("robot", ["me", "*"])
async def test_queries_to_this_robot_and_to_all_are_answered(rig: BusRig, robot: str) -> None:
    await rig.serve(echo)
    assert await rig.get(f"{robot}/control/run/eve", b"go") == [
        (rig.key("me/control/run/eve"), b"go!")
    ]


@pytest.mark.parametrize(
    ("rest", "size", "cause"),
    [
        *((rest, 0, "key") for rest in WILD),
        ("me/control/run/eve", MAX_CONTROL + 1, "oversized"),
    ],
)
async def test_wild_and_oversized_queries_are_dropped_counted_and_ended(
    rig: BusRig, rest: str, size: int, cause: str
) -> None:
    await rig.serve(echo)
    assert await rig.get(rest, bytes(size)) == []
    assert rig.drops.counts() == {f"control/run:{cause}": 1}


async def test_the_address_of_an_asker_that_names_its_session_is_known(rig: BusRig) -> None:
    await rig.serve(lambda query: query.reply(query.source.encode()))
    ((_, unnamed),) = await rig.get("me/control/run/eve")
    assert unnamed == b"an unnamed Zenoh session"
    named = zenoh.SourceInfo(rig.foreign.id, 0)
    replies = await asyncio.to_thread(
        lambda: list(rig.foreign.get(rig.key("me/control/run/eve"), source_info=named, timeout=5.0))
    )
    assert [reply.ok.payload.to_bytes()[:10] for reply in replies if reply.ok] == [b"127.0.0.1:"]
    gone = open_with({**OFF, "listen/endpoints": []}, "a test")
    other = zenoh.SourceInfo(gone.id, 0)
    gone.close()
    replies = await asyncio.to_thread(
        lambda: list(rig.foreign.get(rig.key("me/control/run/eve"), source_info=other, timeout=5.0))
    )
    (source,) = [reply.ok.payload.to_bytes().decode() for reply in replies if reply.ok]
    assert str(other.source_id.zid) in source


async def test_an_answer_may_come_later_and_only_once(rig: BusRig) -> None:
    loop = asyncio.get_running_loop()

    def later(query: Query) -> None:
        loop.call_later(0.05, query.reply, b"first")
        loop.call_later(0.06, query.reply, b"second")
        loop.call_later(0.07, query.drop)

    await rig.serve(later)
    assert await rig.get("me/control/run/eve") == [(rig.key("me/control/run/eve"), b"first")]


async def test_a_flood_of_queries_is_bounded_and_leaves_other_verbs_alone(
    rig: BusRig, until: Until
) -> None:
    """Every query of a flood is handled or counted, and another verb is answered meanwhile."""
    handled: list[bytes] = []

    def on_query(query: Query) -> None:
        handled.append(query.payload)
        query.drop()

    rig.bus.serve("control", "param", on_query)
    await rig.serve(echo)  # declared later: once it answers, the other session knows both
    total = 4 * CAPACITY

    def flood() -> None:
        for _ in range(total):
            rig.foreign.get(
                rig.key("me/control/param/eve"),
                zenoh.handlers.RingChannel(1),
                congestion_control=zenoh.CongestionControl.BLOCK,
                timeout=20.0,
            )

    flooding = asyncio.create_task(asyncio.to_thread(flood))
    longest = 0.0
    while not flooding.done():
        before = time.monotonic()
        await asyncio.sleep(0.005)
        longest = max(longest, time.monotonic() - before)
        assert await rig.get("me/control/run/eve", b"go")
    await flooding
    await until(lambda: bool(handled or rig.drops.counts().get("control/param:full")))
    dropped = rig.drops.counts().get("control/param:full", 0)
    assert 0 < len(handled) + dropped <= total
    print(f"longest tick {1e3 * longest:.1f} ms, handled {len(handled)}, dropped {dropped}")


async def test_the_view_has_the_members_and_is_not_sent_twice_to_one_asker(rig: BusRig) -> None:
    member = Member(robot="r2", instance="b", presence=Presence.FAILED, age=3.0)
    rig.bus.serve_view(lambda: light_status("me", "a"), lambda: (member,), ("r3",))
    while not await rig.get("me/control/members/eve"):
        continue
    ((key, payload),) = await rig.get(
        "*/control/members/eve", encode(MembersQuery(answered=("x",)))
    )
    assert key == rig.key("me/control/members/eve")
    view = view_of(payload)
    assert (view.members, view.roster) == ((member,), ("r3",))
    assert await rig.get("me/control/members/eve", encode(MembersQuery(answered=("me",)))) == []
    assert await rig.get("me/control/members/eve", b"junk") == []
    assert rig.drops.counts() == {"control/members:malformed": 1}


@pytest.mark.parametrize("rest", ["me/state/status", "*/control/members/eve"])
@pytest.mark.parametrize(
    ("selector", "encoding"),
    [
        ("?_format=json", zenoh.Encoding.APPLICATION_JSON),
        ("?a=1;_format=json", zenoh.Encoding.APPLICATION_JSON),
        ("?_format=xml", zenoh.Encoding.ZENOH_BYTES),
        ("", zenoh.Encoding.ZENOH_BYTES),
    ],
)
async def test_an_answer_is_in_json_where_the_selector_asks_for_it(
    rig: BusRig, rest: str, selector: str, encoding: zenoh.Encoding
) -> None:
    status = light_status("me", "a")
    rig.bus.serve_view(lambda: status, lambda: ())
    while not await rig.get(rest):
        continue
    ask = rig.foreign.get
    (reply,) = await asyncio.to_thread(lambda: list(ask(rig.key(rest + selector), timeout=5.0)))
    assert reply.ok is not None
    payload = reply.ok.payload.to_bytes()
    assert reply.ok.encoding == encoding
    assert reply.ok.timestamp is not None  # else a storage's old answer would replace it
    is_json = encoding == zenoh.Encoding.APPLICATION_JSON
    read = msgspec.json.decode(payload) if is_json else msgspec.msgpack.decode(payload[1:])
    answer = status if rest.endswith("status") else PeerView(robot="me", status=status, members=())
    assert read == msgspec.msgpack.decode(msgspec.msgpack.encode(answer))


async def test_the_status_is_published_to_viewers_and_made_for_nobody_else(
    rig: BusRig, until: Until
) -> None:
    made: list[Status] = []

    def status() -> Status:
        made.append(light_status("me", "a"))
        return made[-1]

    rig.bus.publish("status", lambda: encode(status()))
    assert not made
    seen: list[bytes] = []
    viewer = rig.foreign.declare_subscriber(
        rig.key("me/state/status"), lambda sample: seen.append(sample.payload.to_bytes())
    )

    def is_seen() -> bool:
        rig.bus.publish("status", lambda: encode(status()))
        return bool(seen)

    await until(is_seen)
    assert Decoder(Status)(seen[0]).robot == "me"
    viewer.undeclare()

    def is_over() -> bool:
        before = len(made)
        rig.bus.publish("status", lambda: encode(status()))
        return len(made) == before

    await until(is_over)


async def test_after_close_nothing_is_called_and_nothing_raises(rig: BusRig) -> None:
    await rig.serve(echo)
    rig.bus.close()
    rig.bus.close()
    rig.bus.publish("status", lambda: encode(light_status("me", "a")))
    assert await rig.get("me/control/run/eve") == []


@pytest.mark.parametrize(
    ("given", "shown"),
    [
        ("[::ffff:10.0.0.7]:4242", "10.0.0.7:4242"),
        ("10.0.0.7:4242", "10.0.0.7:4242"),
        ("[fe80::1]:4242", "[fe80::1]:4242"),
    ],
)
def test_an_ipv4_address_is_shown_as_one(given: str, shown: str) -> None:
    assert without_mapping(given) == shown


def test_a_name_that_the_table_of_keys_lacks_is_refused(rig: BusRig) -> None:
    for plane, name in (("control", "dance"), ("state", "scan"), ("msg", "run")):
        with pytest.raises(ValueError, match="key_table"):
            rig.bus.serve(plane, name, lambda query: query.drop())
    with pytest.raises(KeyError):
        rig.bus.publish("dance", lambda: b"")


async def test_messages_of_the_own_pattern_go_to_programs_alone(rig: BusRig, until: Until) -> None:
    """Without a program none is sent, and none comes back to be counted."""
    rig.bus.meet_programs(lambda name: name == "me", takes_messages=True)
    programs = rig.bus.programs
    assert programs is not None
    programs.publish("voter_model/opinion", b"\x01\x01")
    taken: list[str] = []

    def has_come() -> bool:
        rig.foreign.put(rig.key("prog/message/voter_model/opinion"), b"\x01\x02")
        taken.extend(message.sender for message in programs.take(time.monotonic()))
        return bool(taken)

    await until(has_come)
    assert {*taken} == {"prog"}
    assert "message:robot" not in rig.drops.counts()
