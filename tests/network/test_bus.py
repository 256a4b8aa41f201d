"""The bus over real sessions: what comes through, what is dropped and counted."""

from __future__ import annotations

import asyncio
import threading
import time
from collections.abc import Awaitable, Callable, Iterator

import pytest
import zenoh

from swarmd.core.codec import MAX_CONTROL, MAX_MESSAGE, Decoder, encode
from swarmd.core.keys import Key
from swarmd.core.messages import Member, PeerView, Presence, Status
from swarmd.network.bus import Query, ZenohBus, members_for_view
from swarmd.network.membership import Membership
from swarmd.network.session import open_session
from swarmd.network.settings import NetworkSettings
from tests.support.fake_daemon import FakeDaemon, light_status

Until = Callable[[Callable[[], bool]], Awaitable[None]]

view_of = Decoder(PeerView)


class BusRig:
    """One bus, and one foreign session that has a link to it."""

    def __init__(self, session: zenoh.Session, foreign: zenoh.Session, swarm: str) -> None:
        self.bus = ZenohBus(session, swarm=swarm, robot="me")
        self.foreign = foreign
        self._session = session
        self._swarm = swarm

    def key(self, rest: str) -> str:
        return f"swarm/{self._swarm}/{rest}"

    def put(self, rest: str, payload: bytes = b"x") -> None:
        """Put without loss: on a busy machine the default drops a message after 1 ms."""
        block = zenoh.CongestionControl.BLOCK
        self.foreign.put(self.key(rest), payload, congestion_control=block)

    async def listen(self) -> list[tuple[Key, bytes]]:
        """The messages that arrive from now on."""
        heard: list[tuple[Key, bytes]] = []
        self.bus.listen("msg", "*/*", lambda key, payload: heard.append((key, payload)))
        await self.meet()
        return heard

    async def serve(self, handler: Callable[[Query], None]) -> None:
        """Return when a query has been answered."""
        self.bus.serve("control", "run", handler)
        while not await self.get("me/control/run"):
            continue

    async def meet(self) -> None:
        """Return when the foreign session has the bus's declarations: they travel in order."""
        key = self.key("me/claim/1")
        token = self._session.liveliness().declare_token(key)
        seen = self.foreign.liveliness().declare_subscriber(
            key, zenoh.handlers.FifoChannel(1), history=True
        )
        await asyncio.to_thread(seen.recv)
        seen.undeclare()
        token.undeclare()

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
    session = open_session(settings)
    foreign = open_session(settings)

    async def make() -> BusRig:
        made = BusRig(session, foreign, settings.swarm)
        await made.meet()
        return made

    made = runner.run(make())
    yield made
    made.bus.close()
    session.close()
    foreign.close()


async def test_messages_of_other_robots_arrive(rig: BusRig, until: Until) -> None:
    heard = await rig.listen()
    rig.put("a/msg/vote/opinion", b"yes")
    await until(lambda: bool(heard))
    assert heard == [(Key(rig.bus.swarm, "a", "msg", "vote/opinion"), b"yes")]
    assert rig.bus.dropped == {}


@pytest.mark.parametrize(
    "rest",
    ["**", "*/msg/vote/opinion", "a/msg/*/opinion", "a/msg/vote/*", "a/**", "me/msg/vote/opinion"],
)
async def test_wild_and_own_keys_are_dropped_and_counted(
    rig: BusRig, until: Until, rest: str
) -> None:
    heard = await rig.listen()
    rig.put(rest)
    await until(lambda: rig.bus.dropped.get("msg/*/*:key") == 1)
    assert heard == []


async def test_deletes_and_oversized_payloads_are_dropped(rig: BusRig, until: Until) -> None:
    heard = await rig.listen()
    rig.foreign.delete(rig.key("a/msg/vote/opinion"))
    rig.put("a/msg/vote/opinion", bytes(MAX_MESSAGE + 1))
    rig.put("a/msg/vote/opinion", bytes(MAX_MESSAGE))
    await until(lambda: bool(heard))
    assert [len(payload) for _, payload in heard] == [MAX_MESSAGE]
    rig.put("a/state/status", bytes(MAX_CONTROL + 1))
    await until(lambda: "state/status:oversized" in rig.bus.dropped)
    assert rig.bus.dropped == {
        "msg/*/*:key": 1,
        "msg/*/*:oversized": 1,
        "state/status:oversized": 1,
    }


def echo(query: Query) -> None:
    query.reply(query.payload + b"!")


@pytest.mark.parametrize("robot", ["me", "*"])
async def test_queries_to_this_robot_and_to_all_are_answered(rig: BusRig, robot: str) -> None:
    await rig.serve(echo)
    assert await rig.get(f"{robot}/control/run", b"go") == [(rig.key("me/control/run"), b"go!")]


@pytest.mark.parametrize(
    ("rest", "size", "cause"),
    [
        *((rest, 0, "key") for rest in ("**", "*/*/run", "me/control/*", "*/control/*", "me/**")),
        ("me/control/run", MAX_CONTROL + 1, "oversized"),
    ],
)
async def test_wild_and_oversized_queries_are_dropped_counted_and_ended(
    rig: BusRig, rest: str, size: int, cause: str
) -> None:
    await rig.serve(echo)
    assert await rig.get(rest, bytes(size)) == []
    assert rig.bus.dropped == {f"control/run:{cause}": 1}


async def test_an_answer_may_come_later_and_only_once(rig: BusRig) -> None:
    loop = asyncio.get_running_loop()

    def later(query: Query) -> None:
        loop.call_later(0.05, query.reply, b"first")
        loop.call_later(0.06, query.reply, b"second")
        loop.call_later(0.07, query.drop)

    await rig.serve(later)
    assert await rig.get("me/control/run") == [(rig.key("me/control/run"), b"first")]


async def test_an_estop_is_taken_as_a_query_and_as_a_put(rig: BusRig, until: Until) -> None:
    heard: list[bytes] = []

    def on_estop(query: Query) -> None:
        heard.append(query.payload)
        query.reply(b"latched")

    rig.bus.serve("safety", "estop", on_estop)
    await rig.meet()
    rig.put("me/safety/estop", b"put")
    await until(lambda: heard == [b"put"])
    assert await rig.get("*/safety/estop", b"query") == [(rig.key("me/safety/estop"), b"latched")]
    rig.put("*/safety/estop", b"wild")
    await until(lambda: rig.bus.dropped == {"safety/estop:put:key": 1})


async def test_a_flood_is_bounded_and_leaves_the_loop_and_estop_alone(
    rig: BusRig, until: Until
) -> None:
    """20,000 messages from another thread: every one handled or counted, an e-stop meanwhile."""
    stops: list[bytes] = []
    rig.bus.serve("safety", "estop", lambda query: stops.append(query.payload))
    heard = await rig.listen()
    total = 20_000

    def flood() -> None:
        publisher = rig.foreign.declare_publisher(
            rig.key("a/msg/vote/opinion"), congestion_control=zenoh.CongestionControl.BLOCK
        )
        for _ in range(total):
            publisher.put(b"flood")

    thread = threading.Thread(target=flood)
    ticks: list[float] = []
    thread.start()
    rig.put("me/safety/estop", b"now")
    while len(heard) + rig.bus.dropped.get("msg/*/*:full", 0) < total:
        before = time.monotonic()
        await asyncio.sleep(0.005)
        ticks.append(time.monotonic() - before)
    thread.join()
    await until(lambda: stops == [b"now"])
    assert len(heard) >= 256
    print(f"longest tick {1e3 * max(ticks):.1f} ms of {len(ticks)}, handled {len(heard)}")


async def test_statuses_that_are_malformed_or_on_a_wrong_key_are_counted(
    rig: BusRig, until: Until
) -> None:
    heard: list[Status] = []
    rig.bus.on_status(heard.append)
    rig.put("a/state/status", b"nonsense")
    rig.put("a/state/status", encode(light_status("b", "1")))
    rig.put("a/state/status", encode(light_status("a", "1")))
    await until(lambda: bool(heard))
    assert [status.robot for status in heard] == ["a"]
    assert rig.bus.dropped == {"state/status:malformed": 1, "state/status:key": 1}
    assert rig.bus.members == {}  # a status without a token makes no member


async def test_tokens_and_statuses_make_members(rig: BusRig, until: Until) -> None:
    news: list[Member] = []
    rig.bus.on_member(news.append)
    token = rig.foreign.liveliness().declare_token(rig.key("a/alive/1"))
    odd = rig.foreign.liveliness().declare_token(rig.key("Not-An-Id/alive/1"))
    await until(lambda: [m.presence for m in news] == [Presence.ALIVE])
    rig.put("a/state/status", encode(light_status("a", "1", has_left=True)))
    await until(lambda: news[-1].presence is Presence.LEFT)
    token.undeclare()
    assert rig.bus.dropped == {"alive:key": 1}
    odd.undeclare()
    assert not rig.bus.forget("nobody")
    assert rig.bus.forget("a")
    assert rig.bus.members == {}


async def test_daemons_discover_and_query_each_other(
    settings: NetworkSettings, until: Until
) -> None:
    one, other = FakeDaemon(settings, "a"), FakeDaemon(settings, "b", roster=("c",))
    async with one, other:
        await until(lambda: len(one.bus.members) == len(other.bus.members) == 1)
        [(robot, payload)] = await one.bus.ask("control", "members")
        view = view_of(payload)
        assert (robot, view.robot, view.roster) == ("b", "b", ("c",))
        assert [(m.robot, m.presence) for m in view.members] == [("a", Presence.ALIVE)]
        assert await one.bus.ask("control", "nothing") == []


async def test_after_close_nothing_is_called_and_nothing_raises(rig: BusRig) -> None:
    heard = await rig.listen()
    rig.bus.close()
    rig.bus.close()
    rig.put("a/msg/vote/opinion")
    rig.bus.publish("state", "status", b"")
    await asyncio.sleep(0.05)
    assert heard == []


def test_a_view_has_living_members_without_status_and_duplicates() -> None:
    membership = Membership("me")
    for robot, instance in (("b", "1"), ("a", "2"), ("a", "1"), ("gone", "1")):
        membership.on_status(light_status(robot, instance), 0.0)
        membership.on_alive(robot, instance, 0.0)
    membership.on_gone("gone", "1", 1.0)
    members = members_for_view(membership, 3.0)
    assert [(m.robot, m.instance, m.presence, m.age) for m in members] == [
        ("a", "1", Presence.ALIVE, 3.0),
        ("a", "2", Presence.ALIVE, 0.0),
        ("b", "1", Presence.ALIVE, 3.0),
        ("gone", "1", Presence.FAILED, 2.0),
    ]
    assert [member.status is None for member in members] == [True, True, True, False]
