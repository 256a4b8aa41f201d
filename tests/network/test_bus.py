"""The bus over real sessions: what comes through, what is dropped and counted."""

from __future__ import annotations

import asyncio
import threading
import time
from collections.abc import Awaitable, Callable, Coroutine
from typing import Any

import pytest
import zenoh

from swarmd.core.codec import MAX_CONTROL, MAX_MESSAGE, Decoder, encode
from swarmd.core.keys import Key
from swarmd.core.messages import Condition, Member, PeerView, Status
from swarmd.network.bus import Query, ZenohBus
from swarmd.network.session import open_session
from swarmd.network.settings import NetworkSettings
from tests.support.fake_daemon import FakeDaemon, light_status

Until = Callable[[Callable[[], bool]], Awaitable[None]]

view_of = Decoder(PeerView)


class Stage:
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


RobotHarness = Callable[[Stage], Coroutine[Any, Any, None]]
Play = Callable[[RobotHarness], None]


@pytest.fixture
def play(settings: NetworkSettings, until: Until) -> Play:
    def run(story: RobotHarness) -> None:
        asyncio.run(_stage(settings, until, story))

    return run


async def _stage(settings: NetworkSettings, until: Until, story: RobotHarness) -> None:
    session = open_session(settings, wait_for_peers=False)
    foreign = open_session(settings, wait_for_peers=False)
    bus = ZenohBus(session, swarm=settings.swarm, robot="me")
    try:
        await until(lambda: bool(foreign.info.peers_zid()))
        await story(Stage(bus, foreign, until, settings.swarm))
    finally:
        bus.close()
        session.close()
        foreign.close()


async def put_until_heard(stage: Stage, rest: str, heard: list[Any]) -> None:
    """Declarations reach the sender a moment after the link is there."""

    def again() -> bool:
        stage.put(rest)
        return bool(heard)

    await stage.until(again)
    await asyncio.sleep(0.05)
    heard.clear()


def test_other_robots_messages_come_through(play: Play) -> None:
    async def story(stage: Stage) -> None:
        heard: list[tuple[Key, bytes]] = []
        stage.bus.listen("msg", "*/*", lambda key, payload: heard.append((key, payload)))
        await put_until_heard(stage, "a/msg/vote/opinion", heard)
        stage.put("a/msg/vote/opinion", b"yes")
        await stage.until(lambda: bool(heard))
        assert heard == [(Key(stage.swarm, "a", "msg", "vote/opinion"), b"yes")]
        assert stage.bus.dropped == {}

    play(story)


@pytest.mark.parametrize(
    "rest",
    ["**", "*/msg/vote/opinion", "a/msg/*/opinion", "a/msg/vote/*", "a/**", "me/msg/vote/opinion"],
)
def test_wild_and_own_keys_are_dropped_and_counted(play: Play, rest: str) -> None:
    async def story(stage: Stage) -> None:
        heard: list[Key] = []
        stage.bus.listen("msg", "*/*", lambda key, payload: heard.append(key))
        await put_until_heard(stage, "a/msg/vote/opinion", heard)
        stage.put(rest)
        await stage.until(lambda: stage.bus.dropped.get("msg/*/*:key") == 1)
        assert heard == []

    play(story)


def test_deletes_and_oversized_payloads_are_dropped_and_counted(play: Play) -> None:
    async def story(stage: Stage) -> None:
        heard: list[bytes] = []
        stage.bus.listen("msg", "*/*", lambda key, payload: heard.append(payload))
        await put_until_heard(stage, "a/msg/vote/opinion", heard)
        stage.foreign.delete(stage.key("a/msg/vote/opinion"))
        stage.put("a/msg/vote/opinion", bytes(MAX_MESSAGE + 1))
        stage.put("a/msg/vote/opinion", bytes(MAX_MESSAGE))
        await stage.until(lambda: bool(heard))
        assert [len(payload) for payload in heard] == [MAX_MESSAGE]
        assert stage.bus.dropped == {"msg/*/*:key": 1, "msg/*/*:oversized": 1}

    play(story)


def echo(query: Query) -> None:
    query.reply(query.payload + b"!")


@pytest.mark.parametrize("robot", ["me", "*"])
def test_the_own_key_and_the_swarms_are_answered(play: Play, robot: str) -> None:
    async def story(stage: Stage) -> None:
        stage.bus.serve("control", "run", echo)
        answers: list[tuple[str, bytes]] = []
        while not answers:
            answers = await stage.get(stage.key(f"{robot}/control/run"), b"go")
        assert answers == [(stage.key("me/control/run"), b"go!")]

    play(story)


@pytest.mark.parametrize("rest", ["**", "*/*/run", "me/control/*", "*/control/*", "me/**"])
def test_other_wild_queries_are_dropped_counted_and_ended(play: Play, rest: str) -> None:
    async def story(stage: Stage) -> None:
        stage.bus.serve("control", "run", echo)
        while not await stage.get(stage.key("me/control/run")):
            continue
        assert await stage.get(stage.key(rest)) == []
        assert stage.bus.dropped == {"control/run:key": 1}

    play(story)


def test_an_oversized_query_is_dropped_counted_and_ended(play: Play) -> None:
    async def story(stage: Stage) -> None:
        stage.bus.serve("control", "run", echo)
        while not await stage.get(stage.key("me/control/run")):
            continue
        assert await stage.get(stage.key("me/control/run"), bytes(MAX_CONTROL + 1)) == []
        assert stage.bus.dropped == {"control/run:oversized": 1}

    play(story)


def test_an_answer_may_come_later_and_only_once(play: Play) -> None:
    async def story(stage: Stage) -> None:
        loop = asyncio.get_running_loop()

        def later(query: Query) -> None:
            loop.call_later(0.05, query.reply, b"first")
            loop.call_later(0.06, query.reply, b"second")
            loop.call_later(0.07, query.drop)

        stage.bus.serve("control", "run", later)
        answers: list[tuple[str, bytes]] = []
        while not answers:
            answers = await stage.get(stage.key("me/control/run"))
        assert answers == [(stage.key("me/control/run"), b"first")]

    play(story)


def test_an_estop_is_taken_as_a_query_and_as_a_put(play: Play) -> None:
    async def story(stage: Stage) -> None:
        heard: list[bytes] = []

        def on_estop(query: Query) -> None:
            heard.append(query.payload)
            query.reply(b"latched")

        stage.bus.serve("safety", "estop", on_estop)
        await put_until_heard(stage, "me/safety/estop", heard)
        stage.put("me/safety/estop", b"put")
        await stage.until(lambda: heard == [b"put"])
        assert await stage.get(stage.key("*/safety/estop"), b"query") == [
            (stage.key("me/safety/estop"), b"latched")
        ]
        stage.put("*/safety/estop", b"wild")
        await stage.until(lambda: stage.bus.dropped == {"safety/estop:put:key": 1})

    play(story)


def test_serving_one_key_twice_is_a_mistake(play: Play) -> None:
    async def story(stage: Stage) -> None:
        stage.bus.serve("control", "run", echo)
        with pytest.raises(ValueError, match="control/run is served already"):
            stage.bus.serve("control", "run", echo)

    play(story)


def test_a_flood_is_bounded_and_leaves_the_loop_and_estop_alone(play: Play) -> None:
    """20,000 messages from another thread: every one handled or counted, an e-stop meanwhile."""

    async def story(stage: Stage) -> None:
        heard: list[Any] = []
        stops: list[bytes] = []
        handled = 0

        def on_message(key: Key, payload: bytes) -> None:
            nonlocal handled
            handled += payload == b"flood"
            heard.append(1)

        stage.bus.listen("msg", "*/*", on_message)
        stage.bus.serve("safety", "estop", lambda query: stops.append(query.payload))
        await put_until_heard(stage, "a/msg/vote/opinion", heard)
        await put_until_heard(stage, "me/safety/estop", stops)
        total = 20_000

        def flood() -> None:
            publisher = stage.foreign.declare_publisher(
                stage.key("a/msg/vote/opinion"), congestion_control=zenoh.CongestionControl.BLOCK
            )
            for _ in range(total):
                publisher.put(b"flood")

        thread = threading.Thread(target=flood)
        ticks: list[float] = []
        thread.start()
        stage.put("me/safety/estop", b"now")
        while handled + stage.bus.dropped.get("msg/*/*:full", 0) < total:
            before = time.monotonic()
            await asyncio.sleep(0.005)
            ticks.append(time.monotonic() - before)
        thread.join()
        await stage.until(lambda: stops == [b"now"])
        assert handled >= 256
        print(f"longest tick {1e3 * max(ticks):.1f} ms of {len(ticks)}, handled {handled}")

    play(story)


def test_statuses_that_cannot_be_are_counted(play: Play) -> None:
    async def story(stage: Stage) -> None:
        await stage.until(lambda: _dropped_after_put(stage, "state/status:malformed"))
        stage.put("a/state/status", encode(light_status("b", "1")))
        await stage.until(lambda: "state/status:key" in stage.bus.dropped)
        assert stage.bus.members == {}

    play(story)


def _dropped_after_put(stage: Stage, kind: str) -> bool:
    stage.put("a/state/status", b"nonsense")
    return kind in stage.bus.dropped


def test_tokens_and_words_make_members(play: Play) -> None:
    async def story(stage: Stage) -> None:
        news: list[Member] = []
        stage.bus.on_member(news.append)
        token = stage.foreign.liveliness().declare_token(stage.key("a/alive/1"))
        await stage.until(lambda: [m.condition for m in news] == [Condition.ALIVE])
        stage.put("a/state/status", encode(light_status("a", "1", has_left=True)))
        await stage.until(lambda: news[-1].condition is Condition.LEFT)
        token.undeclare()
        assert not stage.bus.forget("nobody")
        assert stage.bus.forget("a")
        assert stage.bus.members == {}

    play(story)


def test_statuses_are_told_once_each(play: Play) -> None:
    async def story(stage: Stage) -> None:
        heard: list[Status] = []
        stage.bus.on_status(heard.append)
        await stage.until(lambda: _dropped_after_put(stage, "state/status:malformed"))
        stage.put("b/state/status", encode(light_status("a", "1")))
        stage.put("a/state/status", encode(light_status("a", "1")))
        await stage.until(lambda: bool(heard) and "state/status:key" in stage.bus.dropped)
        assert [status.robot for status in heard] == ["a"]

    play(story)


def test_tokens_that_are_not_ids_are_counted(play: Play) -> None:
    async def story(stage: Stage) -> None:
        token = stage.foreign.liveliness().declare_token(stage.key("Not-An-Id/alive/1"))
        await stage.until(lambda: stage.bus.dropped == {"alive:key": 1})
        assert stage.bus.members == {}
        token.undeclare()

    play(story)


def test_daemons_see_each_other_and_ask_each_other(settings: NetworkSettings, until: Until) -> None:
    async def story() -> None:
        one, other = FakeDaemon(settings, "a"), FakeDaemon(settings, "b", roster=("c",))
        async with one, other:
            await until(lambda: len(one.bus.members) == len(other.bus.members) == 1)
            [(robot, payload)] = await one.bus.ask("control", "members")
            view = view_of(payload)
            assert (robot, view.robot, view.roster) == ("b", "b", ("c",))
            assert [(m.robot, m.condition) for m in view.members] == [("a", Condition.ALIVE)]
            assert await one.bus.ask("control", "nothing") == []

    asyncio.run(story())


def test_a_daemon_that_leaves_left_and_one_that_vanishes_failed(
    settings: NetworkSettings, until: Until
) -> None:
    async def story() -> None:
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

    asyncio.run(story())


def test_after_close_nothing_is_called_and_nothing_raises(play: Play) -> None:
    async def story(stage: Stage) -> None:
        heard: list[Key] = []
        stage.bus.listen("msg", "*/*", lambda key, payload: heard.append(key))
        await put_until_heard(stage, "a/msg/vote/opinion", heard)
        stage.bus.close()
        stage.bus.close()
        stage.put("a/msg/vote/opinion")
        stage.bus.publish("state", "status", b"")
        await asyncio.sleep(0.05)
        assert heard == []

    play(story)
