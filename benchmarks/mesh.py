"""The network alone: cold operators, swarm-wide requests and stops, claims, and a flood.

Daemons without bodies, each a process of its own, so that what is measured is the mesh. "Cold"
starts before the session is opened; a user's key press also costs the start of Python (cli.py).
"""

from __future__ import annotations

import asyncio
import secrets
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager

import zenoh

from benchmarks.table import Row, print_table
from swarmd.core.messages import RunRequest
from swarmd.network.claim import claim_id
from swarmd.network.operator import Operator
from swarmd.network.session import open_session
from swarmd.network.settings import NetworkSettings
from tests.support.fake_daemon import FakeDaemon

RUNS = 50
FLOOD = 300_000
TICK = 0.01


@contextmanager
def daemons(settings: NetworkSettings, count: int) -> Iterator[None]:
    """`count` processes with one light daemon each; they end with their standard input."""
    command = [sys.executable, "-m", "tests.support.fake_daemon", "--swarm", settings.swarm]
    processes = [
        subprocess.Popen(
            [*command, f"tb3-{number:02d}"],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            text=True,
        )
        for number in range(count)
    ]
    try:
        for process in processes:
            assert process.stdout is not None
            process.stdout.readline()
        yield
    finally:
        for process in processes:
            process.communicate("")


def settings() -> NetworkSettings:
    return NetworkSettings(swarm=f"bench-{secrets.token_hex(6)}")


def timed(function: Callable[[], object]) -> float:
    started = time.perf_counter()
    function()
    return time.perf_counter() - started


def switch(where: NetworkSettings, count: int) -> Row:
    short = 0

    def once() -> None:
        nonlocal short
        with Operator(where) as operator:
            view = operator.members()
            outcome = operator.request(RunRequest, view.epochs(view.alive), pattern="x")
        short += len(outcome.applied) < count

    samples = [timed(once) for _ in range(RUNS)]
    budget = "300 ms" if count == 20 else ""
    note = f"open, members, run; all acked in {RUNS - short} of {RUNS}"
    return Row(f"swarm-wide run, cold, {count} daemons", samples, budget, note)


def members(where: NetworkSettings, count: int) -> Row:
    def once() -> None:
        with Operator(where) as operator:
            operator.members()

    return Row(f"members, cold, {count} daemons", [timed(once) for _ in range(RUNS)], "300 ms")


def warm_run(where: NetworkSettings, count: int) -> Row:
    with Operator(where) as operator:
        targets = operator.members().epochs(f"tb3-{number:02d}" for number in range(count))
        samples = [
            timed(lambda: operator.request(RunRequest, targets, pattern="x")) for _ in range(RUNS)
        ]
    return Row(f"swarm-wide run, links up, {count} daemons", samples)


def halts(where: NetworkSettings, count: int) -> Iterator[Row]:
    for verb in ("stop", "estop"):
        short = 0
        done: list[float] = []
        for _ in range(RUNS):
            started = time.perf_counter()
            with Operator(where) as operator:
                outcome = operator.halt(verb)
            done.append(time.perf_counter() - started)
            short += outcome.exit_code != 0
        note = f"until everyone is known and acked: {RUNS - short} of {RUNS}"
        yield Row(f"{verb}, cold, {count} daemons", done, note=note)


def yardstick() -> Row:
    """A bare Zenoh query between two sessions of one process: what nothing here can beat."""
    where = settings()
    one, other = open_session(where), open_session(where)
    try:
        other.declare_queryable("bench/echo", lambda query: query.reply("bench/echo", b""))
        while not list(one.get("bench/echo")):
            continue
        samples = [timed(lambda: list(one.get("bench/echo"))) for _ in range(RUNS * 10)]
    finally:
        one.close()
        other.close()
    return Row("bare Zenoh query (yardstick)", samples)


def claims() -> Row:
    """From the call to the alive token, with one peer there: settling takes 100 ms of it."""
    where = settings()

    async def measure() -> list[float]:
        async with FakeDaemon(where, "other"):
            session = await asyncio.to_thread(open_session, where)
            samples = []
            for number in range(RUNS // 2):
                started = time.perf_counter()
                claim = await claim_id(
                    session,
                    swarm=where.swarm,
                    robot=f"r{number}",
                    instance=secrets.token_hex(6),
                    settle=where.settle,
                    lease=where.lease_seconds,
                    on_duplicate=print,
                )
                samples.append(time.perf_counter() - started)
                claim.release()
            session.close()
            return samples

    return Row("claim of an id", asyncio.run(measure()), note="settling 100 ms included")


def flooded() -> Iterator[Row]:
    """How late a 100 Hz timer of the loop is, alone and while one key is flooded."""
    where = settings()

    async def lateness(seconds: Callable[[], bool]) -> list[float]:
        late = []
        due = time.perf_counter()
        while not seconds():
            due += TICK
            await asyncio.sleep(max(0.0, due - time.perf_counter()))
            late.append(max(0.0, time.perf_counter() - due))
            due = max(due, time.perf_counter() - TICK)
        return late

    async def measure() -> tuple[list[float], list[float], dict[str, int]]:
        async with FakeDaemon(where, "flooded") as daemon:
            daemon.bus.listen("msg", "*/*", lambda key, payload: None)
            foreign = await asyncio.to_thread(open_session, where)
            quiet_until = time.perf_counter() + 2.0
            quiet = await lateness(lambda: time.perf_counter() > quiet_until)
            process = flooder(where)
            loud = await lateness(lambda: process.poll() is not None)
            foreign.close()
            return quiet, loud, daemon.bus.dropped

    quiet, loud, dropped = asyncio.run(measure())
    yield Row("loop lateness, quiet", quiet)
    note = f"{dropped.get('msg/*/*:full', 0)} of {FLOOD} dropped and counted"
    yield Row("loop lateness, one key flooded", loud, note=note)


def flooder(where: NetworkSettings) -> subprocess.Popen[bytes]:
    return subprocess.Popen([sys.executable, "-m", "benchmarks.mesh", "--flood", where.swarm])


def flood(swarm: str) -> None:
    session = open_session(NetworkSettings(swarm=swarm))
    publisher = session.declare_publisher(
        f"swarm/{swarm}/stranger/msg/x/y", congestion_control=zenoh.CongestionControl.BLOCK
    )
    tokens = session.liveliness().declare_subscriber(
        f"swarm/{swarm}/flooded/alive/*", zenoh.handlers.FifoChannel(1), history=True
    )
    tokens.recv()  # by now the bus has declared what it listens to
    for _ in range(FLOOD):
        publisher.put(bytes(100))
    session.close()


def main() -> None:
    rows = [yardstick(), claims(), *flooded()]
    for count in (7, 20):
        where = settings()
        with daemons(where, count):
            rows += [members(where, count), switch(where, count), warm_run(where, count)]
            rows += halts(where, count)
    print_table("Mesh", rows)


if __name__ == "__main__":
    if sys.argv[1:2] == ["--flood"]:
        flood(sys.argv[2])
    else:
        main()
