"""zenohd in front of a swarm: its clients, REST and a storage; and a program in Rust."""

from __future__ import annotations

import contextlib
import subprocess
from collections.abc import Iterator
from pathlib import Path

import msgpack
import pytest
import zenoh

from swarmd.core.keys import ANY, ANYONE, CONTROL, MESSAGE, STATE, build, token
from swarmd.core.messages import Presence, State
from swarmd.link.carriers.session import open_with
from tests.support.processes import CAP, wait_until
from tests.support.zenohd import RUST_EXAMPLE, Zenohd, why_no_zenohd
from tests.swarm.conftest import Swarm

pytestmark = [
    pytest.mark.integration,
    pytest.mark.skipif(bool(why_no_zenohd()), reason=why_no_zenohd()),
]

ROBOTS = ("r01", "r02")


@pytest.fixture(scope="module")
def voting(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Swarm]:
    """A swarm of two robots that meet."""
    with contextlib.closing(Swarm(tmp_path_factory.mktemp("voting"))) as swarm:
        for daemon in [swarm.spawn(robot, swarm.body(robot)) for robot in ROBOTS]:
            daemon.wait_ready()
        for robot, other in (ROBOTS, ROBOTS[::-1]):
            swarm.await_presence(robot, other, Presence.ALIVE)
        yield swarm


@contextlib.contextmanager
def router(swarm: Swarm, folder: Path, *robots: str) -> Iterator[Zenohd]:
    """A router that is linked to these robots."""
    found: dict[str, str] = {}

    def are_found() -> bool:
        found.update((swarm.ctl("zenoh", "--dial", "-o", "json").json or {}).get("robots", {}))
        return found.keys() >= {*robots}

    wait_until(are_found, f"endpoints of {robots}")
    endpoints = [found[robot] for robot in robots]
    with contextlib.closing(Zenohd(folder, swarm.name, endpoints)) as made:
        statuses = build(swarm.name, ANY, STATE, "status")
        keys = {build(swarm.name, robot, STATE, "status") for robot in robots}
        wait_until(lambda: made.values(statuses).keys() >= keys, f"REST reads {robots}")
        yield made


@contextlib.contextmanager
def client_of(zenohd: Zenohd) -> Iterator[zenoh.Session]:
    """A client of that router alone."""
    options = {
        "mode": "client",
        "scouting/multicast/enabled": False,
        "connect/endpoints": [zenohd.endpoint],
    }
    with open_with(options, "a client of zenohd") as session:
        yield session


@pytest.fixture(scope="module")
def zenohd(voting: Swarm) -> Iterator[Zenohd]:
    with router(voting, voting.folder, *ROBOTS) as made:
        yield made


@pytest.fixture
def client(zenohd: Zenohd) -> Iterator[zenoh.Session]:
    with client_of(zenohd) as session:
        yield session


def run(swarm: Swarm) -> None:
    """Let all robots vote on what they hear."""
    swarm.ctl("reset", "--all", "--yes")
    done = swarm.ctl("run", "voter_model", "--all", "-p", "share_period=0.2")
    assert done.code == 0, done


def are_counted(swarm: Swarm) -> bool:
    """True once each robot counts the votes of the other one and of a program."""
    reports = [swarm.status(robot).report for robot in ROBOTS]
    return all(int(report.get("heard", 0)) >= len(ROBOTS) for report in reports)


def await_stored(client: zenoh.Session, key: str) -> None:
    """Wait until zenohd has passed on a publication, so that its storage got that, too."""
    published = client.declare_subscriber(key)
    wait_until(lambda: published.try_recv() is not None, f"zenohd passes {key} on")
    published.undeclare()


def test_a_client_of_zenohd_lists_reads_votes_and_stops(
    voting: Swarm, client: zenoh.Session
) -> None:
    name = voting.name

    def tokens() -> set[str]:
        replies = client.liveliness().get(token(name, ANY), timeout=CAP)
        return {str(reply.ok.key_expr) for reply in replies if reply.ok is not None}

    def answers(key: str, payload: bytes = b"") -> dict[str, str]:
        every = zenoh.QueryTarget.ALL
        replies = client.get(key, target=every, payload=payload, timeout=CAP)
        read = [msgpack.unpackb(reply.ok.payload.to_bytes()[1:]) for reply in replies if reply.ok]
        return {answer["robot"]: answer.get("code") or answer["state"] for answer in read}

    wait_until(lambda: tokens() >= {token(name, robot) for robot in ROBOTS}, "tokens of robots")
    run(voting)
    wait_until(
        lambda: answers(build(name, ANY, STATE, "status")) == dict.fromkeys(ROBOTS, "running"),
        "the client reads the statuses",
    )
    heard = set[str]()
    votes = build(name, ANY, MESSAGE, ANY, ANY)
    client.declare_subscriber(votes, lambda sample: heard.add(str(sample.key_expr).split("/")[2]))
    key = build(name, "teacher", MESSAGE, "voter_model", "opinion")

    def votes_count() -> bool:
        client.put(key, b"\x01" + msgpack.packb(2))
        return are_counted(voting)

    wait_until(votes_count, "all robots hear the program")
    wait_until(lambda: heard >= {*ROBOTS}, "the client hears the votes of robots")
    stop = b"\x01" + msgpack.packb({"verb": "stop", "id": "behind-zenohd", "operator": "prog"})
    every, applied = build(name, ANY, CONTROL, "stop", ANYONE), dict.fromkeys(ROBOTS, "applied")
    wait_until(lambda: answers(every, stop) == applied, "both robots answer one stop")
    for robot in ROBOTS:
        voting.await_state(robot, State.STOPPED)


def test_rest_reads_robots_in_json(voting: Swarm, zenohd: Zenohd, client: zenoh.Session) -> None:
    key = build(voting.name, ROBOTS[0], STATE, "status")
    await_stored(client, key)

    def is_read() -> bool:  # a status that is stored after the answer is newer: base64
        status = zenohd.values(f"{key}?_format=json").get(key)
        return isinstance(status, dict) and status["robot"] == ROBOTS[0]

    wait_until(is_read, "REST reads a status")
    members = build(voting.name, ANY, CONTROL, "members", ANYONE)
    views = {build(voting.name, robot, CONTROL, "members", ANYONE) for robot in ROBOTS}
    wait_until(
        lambda: zenohd.values(f"{members}?_format=json").keys() >= views, "REST asks each robot"
    )


def test_a_program_in_rust_lists_votes_and_stops(voting: Swarm) -> None:
    def example(*words: str) -> list[str]:
        command = [str(RUST_EXAMPLE), voting.name, *words]
        done = subprocess.run(command, capture_output=True, text=True, timeout=CAP, check=False)
        return done.stdout.splitlines()

    wait_until(lambda: {*example("list")} >= {*ROBOTS}, "the program lists the robots")
    run(voting)
    with subprocess.Popen([str(RUST_EXAMPLE), voting.name, "vote", "teacher", "2"]) as program:
        try:
            wait_until(lambda: are_counted(voting), "all robots hear the program")
            wait_until(lambda: "teacher" in example("list"), "the program lists the other one")
        finally:
            program.kill()
    applied = {f"{robot} applied" for robot in ROBOTS}
    wait_until(lambda: {*example("stop")} >= applied, "both robots answer one stop")
    for robot in ROBOTS:
        voting.await_state(robot, State.STOPPED)


def test_a_storage_keeps_the_last_status_of_a_robot_that_ended(
    voting: Swarm, tmp_path: Path
) -> None:
    late = voting.start("late", voting.body("late"))
    key = build(voting.name, "late", STATE, "status")
    with router(voting, tmp_path, "late") as zenohd:
        with client_of(zenohd) as client:
            await_stored(client, key)
        late.terminate()
        payload = bytearray()

        def is_stored() -> bool:
            payload[:] = zenohd.get(f"{key}?_raw=true")
            return bool(payload)

        wait_until(is_stored, "the storage has a status")
    assert msgpack.unpackb(payload[1:])["robot"] == "late"
    voting.ctl("members", "forget", "late")
