"""Attacks by plain sockets on the datagrams of a secured swarm of real daemons on loopback."""

from __future__ import annotations

import contextlib
from collections.abc import Iterator

import pytest

from swarmd.core.messages import Presence, State
from swarmd.link.carriers.udp import GROUP4, GROUP_PORT
from swarmd.link.datagram import (
    KIND_OFFSET,
    Ack,
    Beacon,
    Datagram,
    Flag,
    Kind,
    Solicit,
    Stop,
    length_without_trailer,
    pack,
)
from tests.support.processes import wait_until
from tests.support.secured_swarm import SecuredSwarm

pytestmark = pytest.mark.integration


@pytest.fixture(scope="module")
def swarm(tmp_path_factory: pytest.TempPathFactory) -> Iterator[SecuredSwarm]:
    with contextlib.ExitStack() as left:
        yield SecuredSwarm(tmp_path_factory.mktemp("secured"), left).start()


def test_what_strangers_forge_and_replay_moves_no_daemon(swarm: SecuredSwarm) -> None:
    stranger, r1 = swarm.stranger, swarm.stranger.address_of("r1")
    wait_until(lambda: set(swarm.anna.members().alive) == {"r1", "r2"}, "both are alive")
    forged: tuple[Datagram, ...] = (
        Stop(id="s", verb="estop", operator="anna", scope="swarm"),
        Beacon(robot="r1", instance=b"ghosts", sequence=9, wire=3, state=1, revision=1),
        Beacon(
            robot="r2", instance=b"ghosts", sequence=2**50, wire=3, state=1, revision=1,
            flags=Flag.LEFT,
        ),
        Ack(id="s", robot="r2", instance=b"ghosts", revision=1, code="applied"),
        Solicit(echo=5, wants_members=True),
    )  # fmt: skip
    trailers = [bytes(29)]
    trailers += [raw[length_without_trailer(raw) :] for _, raw, _ in stranger.recorded(Beacon)[:1]]
    for body in forged:
        for trailer in (b"", *trailers):
            stranger.mouth.sendto(pack(stranger.tag, body) + trailer, r1)
    wait_until(
        lambda: (
            swarm.dropped("r1", "unsigned") >= len(forged)
            and swarm.dropped("r1", "forged") >= len(forged)
        ),
        "all are counted",
    )
    assert swarm.status("r1").state is State.IDLE
    wait_until(lambda: "refused datagrams: " in swarm.daemons["r1"].text(), "it is logged")
    stranger.mouth.setblocking(False)
    with pytest.raises(BlockingIOError):
        stranger.mouth.recv(2000)  # no question was answered

    # A robot that is gone stays gone, whatever was recorded of it.
    swarm.daemons["r2"].kill()
    wait_until(lambda: swarm.presence("r2") is Presence.FAILED, "r2 is gone")
    before = swarm.dropped("r1", "unproven")
    beacons = [raw for body, raw, _ in stranger.recorded(Beacon) if body.robot == "r2"]  # type: ignore[union-attr]
    for raw in beacons:
        stranger.mouth.sendto(raw, r1)
        stranger.mouth.sendto(raw, (GROUP4, GROUP_PORT))
    wait_until(lambda: swarm.dropped("r1", "unproven") > before, "it is counted")
    assert swarm.presence("r2") is Presence.FAILED
    again = swarm.spawn("r2").wait_ready()  # replays of its own beacons do not hold its id
    for raw in beacons:
        stranger.mouth.sendto(raw, stranger.address_of("r2"))
    wait_until(lambda: swarm.presence("r2") is Presence.ALIVE, "r2 is back")
    assert swarm.status("r2").state is State.IDLE
    assert again.process.poll() is None


def test_a_replayed_estop_renews_no_latch_that_was_reset(swarm: SecuredSwarm) -> None:
    stranger = swarm.stranger
    assert swarm.anna.send_stop("estop").exit_code == 0
    assert swarm.status("r1").state is State.ESTOPPED
    latches: list[bytes] = []

    def hears_latches() -> bool:
        latches[:] = [raw for raw, _ in list(stranger._heard) if raw[KIND_OFFSET] == Kind.LATCHES]
        return bool(latches)

    wait_until(hears_latches, "the robots send their new latches to all")
    for robot in ("r1", "r2"):
        swarm.reset(robot)
    estops = [raw for body, raw, _ in stranger.recorded(Stop)]
    assert estops
    r1 = stranger.address_of("r1")

    def replay() -> bool:
        for raw in (*estops, *latches):
            stranger.mouth.sendto(raw, r1)
        return swarm.dropped("r1", "repeated") > 0

    # Until r1 has heard that r2 was reset, the latches of r2 are no repetition.
    wait_until(replay, "latches are counted")
    assert swarm.status("r1").state is State.IDLE

    # A robot that restarts knows what it heard before.
    swarm.daemons["r1"].kill()
    again = swarm.spawn("r1").wait_ready()
    wait_until(lambda: stranger.address_of("r1") != r1, "r1 is heard at its new address")
    wait_until(lambda: "r1" in swarm.anna.members().answered, "r1 is back")
    for raw in estops:
        stranger.mouth.sendto(raw, stranger.address_of("r1"))
    wait_until(lambda: "refused a replayed estop of anna" in again.text(), "it is logged")
    assert swarm.status("r1").state is State.IDLE
    # The operator's next stop counts.
    assert swarm.anna.send_stop("estop").exit_code == 0
    assert swarm.status("r1").state is State.ESTOPPED
