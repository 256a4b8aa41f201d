"""The bus over real sessions: what comes through, what is dropped and counted."""

from __future__ import annotations

import asyncio
import threading
import time
from collections.abc import Awaitable, Callable, Coroutine
from typing import Any

import pytest
import zenoh

from swarmd.core.codec import MAX_CONTROL, MAX_MESSAGE, MAX_SENSE, Decoder, encode
from swarmd.core.keys import Key
from swarmd.core.messages import Condition, Member, PeerView, Status
from swarmd.network.bus import Query, ZenohBus, limit_of, matches, members_for_view
from swarmd.network.membership import Membership
from swarmd.network.session import open_session
from swarmd.network.settings import NetworkSettings
from tests.support.fake_daemon import FakeDaemon, light_status

Until = Callable[[Callable[[], bool]], Awaitable[None]]

view_of = Decoder(PeerView)


class BusRig:
    """One bus, and one foreign session that has a link to it."""

    def __init__(self, bus: ZenohBus, foreign: zenoh.Session, until: Until, swarm: str) -> None:
        self.bus = bus
        self.foreign = foreign
        self.until = until
        self.swarm = swarm

    def key(self, rest: str) -> str:
        return f"swarm/{self.swarm}/{rest}"

    def put(self, rest: str, payload: bytes = b"x") -> None:
        self.foreign.put(self.key(rest), payload)

    async def get(self, key: str, payload: bytes = b"") -> list[tuple[str, bytes]]:
        def asked() -> list[tuple[str, bytes]]:
            replies = self.foreign.get(
                key,
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


Steps = Callable[[BusRig], Coroutine[Any, Any, None]]
RunSteps = Callable[[Steps], None]


@pytest.fixture
def run_steps(settings: NetworkSettings, until: Until) -> RunSteps:
    def run(steps: Steps) -> None:
        asyncio.run(_run_steps(settings, until, steps))

    return run


async def _run_steps(settings: NetworkSettings, until: Until, steps: Steps) -> None:
    session = open_session(settings, wait_for_peers=False)
    foreign = open_session(settings, wait_for_peers=False)
    bus = ZenohBus(session, swarm=settings.swarm, robot="me")
    try:
        await until(lambda: bool(foreign.info.peers_zid()))
        await steps(BusRig(bus, foreign, until, settings.swarm))
    finally:
        bus.close()
        session.close()
        foreign.close()


async def put_until_heard(rig: BusRig, rest: str, heard: list[Any]) -> None:
    """Declarations reach the sender a moment after the link is there."""

    def again() -> bool:
        rig.put(rest)
        return bool(heard)

    await rig.until(again)
    await asyncio.sleep(0.05)
    heard.clear()


def test_messages_of_other_robots_arrive(run_steps: RunSteps) -> None:
    async def steps(rig: BusRig) -> None:
        heard: list[tuple[Key, bytes]] = []
        rig.bus.listen("msg", "*/*", lambda key, payload: heard.append((key, payload)))
        await put_until_heard(rig, "a/msg/vote/opinion", heard)
        rig.put("a/msg/vote/opinion", b"yes")
        await rig.until(lambda: bool(heard))
        assert heard == [(Key(rig.swarm, "a", "msg", "vote/opinion"), b"yes")]
        assert rig.bus.dropped == {}

    run_steps(steps)


@pytest.mark.parametrize(
    "rest",
    ["**", "*/msg/vote/opinion", "a/msg/*/opinion", "a/msg/vote/*", "a/**", "me/msg/vote/opinion"],
)
def test_wild_and_own_keys_are_dropped_and_counted(run_steps: RunSteps, rest: str) -> None:
    async def steps(rig: BusRig) -> None:
        heard: list[Key] = []
        rig.bus.listen("msg", "*/*", lambda key, payload: heard.append(key))
        await put_until_heard(rig, "a/msg/vote/opinion", heard)
        rig.put(rest)
        await rig.until(lambda: rig.bus.dropped.get("msg/*/*:key") == 1)
        assert heard == []

    run_steps(steps)


def test_deletes_and_oversized_payloads_are_dropped_and_counted(run_steps: RunSteps) -> None:
    async def steps(rig: BusRig) -> None:
        heard: list[bytes] = []
        rig.bus.listen("msg", "*/*", lambda key, payload: heard.append(payload))
        await put_until_heard(rig, "a/msg/vote/opinion", heard)
        rig.foreign.delete(rig.key("a/msg/vote/opinion"))
        rig.put("a/msg/vote/opinion", bytes(MAX_MESSAGE + 1))
        rig.put("a/msg/vote/opinion", bytes(MAX_MESSAGE))
        await rig.until(lambda: bool(heard))
        assert [len(payload) for payload in heard] == [MAX_MESSAGE]
        assert rig.bus.dropped == {"msg/*/*:key": 1, "msg/*/*:oversized": 1}

    run_steps(steps)


def echo(query: Query) -> None:
    query.reply(query.payload + b"!")


@pytest.mark.parametrize("robot", ["me", "*"])
def test_queries_to_this_robot_and_to_all_are_answered(run_steps: RunSteps, robot: str) -> None:
    async def steps(rig: BusRig) -> None:
        rig.bus.serve("control", "run", echo)
        answers: list[tuple[str, bytes]] = []
        while not answers:
            answers = await rig.get(rig.key(f"{robot}/control/run"), b"go")
        assert answers == [(rig.key("me/control/run"), b"go!")]

    run_steps(steps)


@pytest.mark.parametrize("rest", ["**", "*/*/run", "me/control/*", "*/control/*", "me/**"])
def test_other_wild_queries_are_dropped_counted_and_ended(run_steps: RunSteps, rest: str) -> None:
    async def steps(rig: BusRig) -> None:
        rig.bus.serve("control", "run", echo)
        while not await rig.get(rig.key("me/control/run")):
            continue
        assert await rig.get(rig.key(rest)) == []
        assert rig.bus.dropped == {"control/run:key": 1}

    run_steps(steps)


def test_an_oversized_query_is_dropped_counted_and_ended(run_steps: RunSteps) -> None:
    async def steps(rig: BusRig) -> None:
        rig.bus.serve("control", "run", echo)
        while not await rig.get(rig.key("me/control/run")):
            continue
        assert await rig.get(rig.key("me/control/run"), bytes(MAX_CONTROL + 1)) == []
        assert rig.bus.dropped == {"control/run:oversized": 1}

    run_steps(steps)


def test_an_answer_may_come_later_and_only_once(run_steps: RunSteps) -> None:
    async def steps(rig: BusRig) -> None:
        loop = asyncio.get_running_loop()

        def later(query: Query) -> None:
            loop.call_later(0.05, query.reply, b"first")
            loop.call_later(0.06, query.reply, b"second")
            loop.call_later(0.07, query.drop)

        rig.bus.serve("control", "run", later)
        answers: list[tuple[str, bytes]] = []
        while not answers:
            answers = await rig.get(rig.key("me/control/run"))
        assert answers == [(rig.key("me/control/run"), b"first")]

    run_steps(steps)


def test_an_estop_is_taken_as_a_query_and_as_a_put(run_steps: RunSteps) -> None:
    async def steps(rig: BusRig) -> None:
        heard: list[bytes] = []

        def on_estop(query: Query) -> None:
            heard.append(query.payload)
            query.reply(b"latched")

        rig.bus.serve("safety", "estop", on_estop)
        await put_until_heard(rig, "me/safety/estop", heard)
        rig.put("me/safety/estop", b"put")
        await rig.until(lambda: heard == [b"put"])
        assert await rig.get(rig.key("*/safety/estop"), b"query") == [
            (rig.key("me/safety/estop"), b"latched")
        ]
        rig.put("*/safety/estop", b"wild")
        await rig.until(lambda: rig.bus.dropped == {"safety/estop:put:key": 1})

    run_steps(steps)


def test_serving_one_key_twice_raises(run_steps: RunSteps) -> None:
    async def steps(rig: BusRig) -> None:
        rig.bus.serve("control", "run", echo)
        with pytest.raises(ValueError, match="control/run is served already"):
            rig.bus.serve("control", "run", echo)

    run_steps(steps)


def test_a_flood_is_bounded_and_leaves_the_loop_and_estop_alone(run_steps: RunSteps) -> None:
    """20,000 messages from another thread: every one handled or counted, an e-stop meanwhile."""

    async def steps(rig: BusRig) -> None:
        heard: list[Any] = []
        stops: list[bytes] = []
        handled = 0

        def on_message(key: Key, payload: bytes) -> None:
            nonlocal handled
            handled += payload == b"flood"
            heard.append(1)

        rig.bus.listen("msg", "*/*", on_message)
        rig.bus.serve("safety", "estop", lambda query: stops.append(query.payload))
        await put_until_heard(rig, "a/msg/vote/opinion", heard)
        await put_until_heard(rig, "me/safety/estop", stops)
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
        while handled + rig.bus.dropped.get("msg/*/*:full", 0) < total:
            before = time.monotonic()
            await asyncio.sleep(0.005)
            ticks.append(time.monotonic() - before)
        thread.join()
        await rig.until(lambda: stops == [b"now"])
        assert handled >= 256
        print(f"longest tick {1e3 * max(ticks):.1f} ms of {len(ticks)}, handled {handled}")

    run_steps(steps)


def test_malformed_statuses_are_counted(run_steps: RunSteps) -> None:
    async def steps(rig: BusRig) -> None:
        await rig.until(lambda: _dropped_after_put(rig, "state/status:malformed"))
        rig.put("a/state/status", encode(light_status("b", "1")))
        await rig.until(lambda: "state/status:key" in rig.bus.dropped)
        assert rig.bus.members == {}

    run_steps(steps)


def _dropped_after_put(rig: BusRig, kind: str) -> bool:
    rig.put("a/state/status", b"nonsense")
    return kind in rig.bus.dropped


def test_tokens_and_statuses_make_members(run_steps: RunSteps) -> None:
    async def steps(rig: BusRig) -> None:
        news: list[Member] = []
        rig.bus.on_member(news.append)
        token = rig.foreign.liveliness().declare_token(rig.key("a/alive/1"))
        await rig.until(lambda: [m.condition for m in news] == [Condition.ALIVE])
        rig.put("a/state/status", encode(light_status("a", "1", has_left=True)))
        await rig.until(lambda: news[-1].condition is Condition.LEFT)
        token.undeclare()
        assert not rig.bus.forget("nobody")
        assert rig.bus.forget("a")
        assert rig.bus.members == {}

    run_steps(steps)


def test_each_status_is_reported_once(run_steps: RunSteps) -> None:
    async def steps(rig: BusRig) -> None:
        heard: list[Status] = []
        rig.bus.on_status(heard.append)
        await rig.until(lambda: _dropped_after_put(rig, "state/status:malformed"))
        rig.put("b/state/status", encode(light_status("a", "1")))
        rig.put("a/state/status", encode(light_status("a", "1")))
        await rig.until(lambda: bool(heard) and "state/status:key" in rig.bus.dropped)
        assert [status.robot for status in heard] == ["a"]

    run_steps(steps)


def test_tokens_that_are_not_ids_are_counted(run_steps: RunSteps) -> None:
    async def steps(rig: BusRig) -> None:
        token = rig.foreign.liveliness().declare_token(rig.key("Not-An-Id/alive/1"))
        await rig.until(lambda: rig.bus.dropped == {"alive:key": 1})
        assert rig.bus.members == {}
        token.undeclare()

    run_steps(steps)


def test_daemons_discover_and_query_each_other(settings: NetworkSettings, until: Until) -> None:
    async def steps() -> None:
        one, other = FakeDaemon(settings, "a"), FakeDaemon(settings, "b", roster=("c",))
        async with one, other:
            await until(lambda: len(one.bus.members) == len(other.bus.members) == 1)
            [(robot, payload)] = await one.bus.ask("control", "members")
            view = view_of(payload)
            assert (robot, view.robot, view.roster) == ("b", "b", ("c",))
            assert [(m.robot, m.condition) for m in view.members] == [("a", Condition.ALIVE)]
            assert await one.bus.ask("control", "nothing") == []

    asyncio.run(steps())


def test_leaving_is_left_and_vanishing_is_failed(settings: NetworkSettings, until: Until) -> None:
    async def steps() -> None:
        polite, rude = FakeDaemon(settings, "polite"), FakeDaemon(settings, "rude")
        async with FakeDaemon(settings, "a") as watcher:
            await polite.start()
            await rude.start()
            await until(lambda: len(watcher.bus.members) == 2)
            polite.leave()
            rude.vanish()

            def conditions() -> dict[str, Condition]:
                return {m.robot: m.condition for m in watcher.bus.members.values()}

            await until(lambda: Condition.ALIVE not in conditions().values())
            assert conditions() == {"polite": Condition.LEFT, "rude": Condition.FAILED}

    asyncio.run(steps())


def test_after_close_nothing_is_called_and_nothing_raises(run_steps: RunSteps) -> None:
    async def steps(rig: BusRig) -> None:
        heard: list[Key] = []
        rig.bus.listen("msg", "*/*", lambda key, payload: heard.append(key))
        await put_until_heard(rig, "a/msg/vote/opinion", heard)
        rig.bus.close()
        rig.bus.close()
        rig.put("a/msg/vote/opinion")
        rig.bus.publish("state", "status", b"")
        await asyncio.sleep(0.05)
        assert heard == []

    run_steps(steps)


@pytest.mark.parametrize(
    ("name", "wanted", "is_match"),
    [
        ("vote/opinion", "vote/opinion", True),
        ("vote/opinion", "*/*", True),
        ("vote/opinion", "vote/*", True),
        ("vote/opinion", "*", False),
        ("status", "*/*", False),
        ("status", "estop", False),
    ],
)
def test_names_match_chunk_by_chunk(name: str, wanted: str, is_match: bool) -> None:
    assert matches(name, wanted) is is_match


def test_sizes_are_limited_by_plane() -> None:
    planes = ("msg", "sense", "hw", "state", "safety")
    assert [limit_of(plane) for plane in planes] == [
        MAX_MESSAGE,
        MAX_SENSE,
        MAX_SENSE,
        MAX_CONTROL,
        MAX_CONTROL,
    ]


def test_a_view_has_living_members_without_status_and_duplicates() -> None:
    membership = Membership("me")
    for robot, instance in (("b", "1"), ("a", "2"), ("a", "1"), ("gone", "1")):
        membership.on_status(light_status(robot, instance), 0.0)
        membership.on_alive(robot, instance, 0.0)
    membership.on_gone("gone", "1", 1.0)
    members = members_for_view(membership, 3.0)
    assert [(member.robot, member.instance, member.condition) for member in members] == [
        ("a", "1", Condition.ALIVE),
        ("a", "2", Condition.ALIVE),
        ("b", "1", Condition.ALIVE),
        ("gone", "1", Condition.FAILED),
    ]
    assert [member.status is None for member in members] == [True, True, True, False]
    assert [member.age for member in members] == [3.0, 0.0, 3.0, 2.0]
