"""Garbage on every key the bus listens to: it goes on, and nothing goes uncounted."""

from __future__ import annotations

import asyncio
import random
from collections.abc import Awaitable, Callable

import pytest
import zenoh

from swarmd.core.codec import Decoder, encode
from swarmd.core.errors import CodecError
from swarmd.core.keys import Key
from swarmd.core.messages import RunRequest
from swarmd.network.bus import Query, ZenohBus
from swarmd.network.session import open_session
from swarmd.network.settings import NetworkSettings
from tests.support.fake_daemon import light_status

Until = Callable[[Callable[[], bool]], Awaitable[None]]

PUTS = 10_000
QUERIES = 1_000
ROBOTS = ("me", "a", "b", "*", "**", "a$*", "tb3-01", "Not-An-Id")
NAMES = {
    "msg": ("vote/opinion", "vote/*", "*/*", "**", "vote/Opinion", "vote/a/b"),
    "state": ("status", "*", "**", "status/x"),
    "safety": ("estop", "*", "**"),
    "control": ("run", "*", "**"),
    "alive": ("123", "*"),
    "*": ("run", "estop", "status", "*", "**"),
    "hw": ("scan",),
}
request_of = Decoder(RunRequest)


def key(rng: random.Random, swarm: str) -> str:
    if rng.random() < 0.02:
        return rng.choice(("**", "swarm/**", f"swarm/{swarm}/**", "*/*/*/*/*"))
    plane = rng.choice(list(NAMES))
    return f"swarm/{swarm}/{rng.choice(ROBOTS)}/{plane}/{rng.choice(NAMES[plane])}"


def payload(rng: random.Random) -> bytes:
    whole = encode(light_status(rng.choice(("a", "me", "c")), "123"))
    kind = rng.random()
    if kind < 0.4:
        return rng.randbytes(rng.randrange(100))
    if kind < 0.7:
        return whole[: rng.randrange(len(whole))]
    if kind < 0.72:
        return bytes(rng.randrange(60_000, 90_000))
    return whole


class Target:
    """A bus that counts what its handlers get, by queue."""

    def __init__(self, bus: ZenohBus) -> None:
        self.bus = bus
        self.handled = {"msg/*/*": 0, "state/status": 0, "safety/estop": 0, "control/run": 0}
        bus.listen("msg", "*/*", self._on("msg/*/*"))
        bus.listen("state", "status", self._on("state/status"))
        bus.serve("safety", "estop", self._serve("safety/estop"))
        bus.serve("control", "run", self._serve("control/run"))

    def counted(self, queue: str) -> int:
        """What came through and what was dropped by the bus before any handler saw it."""
        causes = ("key", "oversized", "full")
        return self.handled[queue] + sum(
            self.bus.dropped.get(f"{queue}:{cause}", 0) for cause in causes
        )

    def estops(self) -> int:
        """Those asked for and those put, which are nobody's way to ask."""
        causes = ("key", "oversized", "full")
        puts = (self.bus.dropped.get(f"safety/estop:put:{cause}", 0) for cause in causes)
        return self.counted("safety/estop") + sum(puts)

    def _on(self, queue: str) -> Callable[[Key, bytes], None]:
        def handle(heard: Key, _payload: bytes) -> None:
            assert heard.robot != "me"
            self.handled[queue] += 1

        return handle

    def _serve(self, queue: str) -> Callable[[Query], None]:
        def handle(query: Query) -> None:
            self.handled[queue] += 1
            try:
                request_of(query.payload)
            except CodecError:
                self.bus.drop(f"{queue}:malformed")
            query.drop()

        return handle


@pytest.mark.parametrize("seed", [1, 2])
def test_every_put_and_every_query_is_handled_or_counted(
    settings: NetworkSettings, until: Until, seed: int
) -> None:
    rng = random.Random(seed)
    swarm = settings.swarm

    async def steps() -> None:
        session = open_session(settings, wait_for_peers=False)
        foreign = open_session(settings, wait_for_peers=False)
        target = Target(ZenohBus(session, swarm=swarm, robot="me"))
        try:
            # Declarations travel in order: the last one having arrived, all have.
            token = session.liveliness().declare_token(f"swarm/{swarm}/me/alive/1")
            seen = foreign.liveliness().declare_subscriber(
                "swarm/**", zenoh.handlers.FifoChannel(1), history=True
            )
            await asyncio.to_thread(seen.recv)
            expected = await asyncio.to_thread(flood, foreign, rng, swarm)
            await until(lambda: target.counted("msg/*/*") >= expected["msg/*/*"])
            await until(lambda: target.estops() >= expected["safety/estop"])
            # The bus itself listens to statuses as well: each queue counts what it drops.
            await until(lambda: target.counted("state/status") >= expected["state/status"])
            assert target.counted("msg/*/*") == expected["msg/*/*"]
            assert target.estops() == expected["safety/estop"]
            ended = await asyncio.to_thread(ask, foreign, rng, swarm)
            assert ended == QUERIES
            assert target.counted("control/run") > 0
            token.undeclare()
        finally:
            target.bus.close()
            session.close()
            foreign.close()

    asyncio.run(steps())


def flood(foreign: zenoh.Session, rng: random.Random, swarm: str) -> dict[str, int]:
    """Put garbage; how many of the puts concern each queue, by Zenoh's own rules."""
    lanes = {
        "msg/*/*": zenoh.KeyExpr(f"swarm/{swarm}/*/msg/*/*"),
        "state/status": zenoh.KeyExpr(f"swarm/{swarm}/*/state/status"),
        "safety/estop": zenoh.KeyExpr(f"swarm/{swarm}/me/safety/estop"),
    }
    expected = dict.fromkeys(lanes, 0)
    for _ in range(PUTS):
        where = zenoh.KeyExpr.autocanonize(key(rng, swarm))
        foreign.put(where, payload(rng), congestion_control=zenoh.CongestionControl.BLOCK)
        for queue, key_expr in lanes.items():
            expected[queue] += where.intersects(key_expr)
    return expected


def ask(foreign: zenoh.Session, rng: random.Random, swarm: str) -> int:
    """Query garbage; how many of the queries ended."""
    ended = 0
    for _ in range(QUERIES):
        where = zenoh.KeyExpr.autocanonize(key(rng, swarm))
        list(foreign.get(where, target=zenoh.QueryTarget.ALL, payload=payload(rng), timeout=30.0))
        ended += 1
    return ended
