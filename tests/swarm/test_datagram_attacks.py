"""Attacks by plain sockets on the datagrams of a secured swarm of real daemons on loopback."""

from __future__ import annotations

import contextlib
import socket
import struct
import threading
from collections.abc import Iterator
from pathlib import Path
from types import UnionType

import pytest

from swarmd.core.messages import Presence, State, Status
from swarmd.core.verbs import ResetRequest
from swarmd.network.carriers.udp import GROUP4, GROUP_PORT
from swarmd.network.datagram import (
    KIND_OFFSET,
    Ack,
    Address,
    Beacon,
    Datagram,
    Flag,
    Kind,
    Solicit,
    Stop,
    length_without_trailer,
    pack,
    tag_of,
    unpack,
)
from swarmd.network.operator.operator import Operator
from swarmd.network.settings import NetworkSettings
from tests.support.keys import SwarmKeys
from tests.support.processes import DaemonProcess, unique_swarm, wait_until

pytestmark = pytest.mark.integration


class Stranger:
    """A stranger on the network: receives all datagrams of the group, and sends any."""

    def __init__(self, tag: bytes) -> None:
        self.tag = tag
        self._heard: list[tuple[bytes, Address]] = []
        self._ear = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._ear.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        self._ear.bind((GROUP4, GROUP_PORT))
        index = socket.if_nametoindex("lo")
        group = struct.pack("4s4si", socket.inet_aton(GROUP4), bytes(4), index)
        self._ear.setsockopt(socket.IPPROTO_IP, socket.IP_ADD_MEMBERSHIP, group)
        self._ear.settimeout(0.1)
        self.mouth = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self.mouth.bind(("127.0.0.1", 0))
        self._ended = threading.Event()
        self._thread = threading.Thread(target=self._listen)
        self._thread.start()

    def close(self) -> None:
        self._ended.set()
        self._thread.join()
        self._ear.close()
        self.mouth.close()

    def recorded(self, kind: type[Datagram] | UnionType) -> list[tuple[Datagram, bytes, Address]]:
        """What was heard of a kind: body, bytes and source."""
        found = []
        for payload, source in list(self._heard):
            body = unpack(self.tag, payload)
            if isinstance(body, kind):
                found.append((body, payload, source))
        return found

    def address_of(self, robot: str) -> Address:
        wait_until(lambda: robot in self._addresses(), f"{robot} is heard")
        return self._addresses()[robot]

    def _addresses(self) -> dict[str, Address]:
        heard = self.recorded(Beacon)
        return {body.robot: source for body, _, source in heard if isinstance(body, Beacon)}

    def _listen(self) -> None:
        while not self._ended.is_set():
            with contextlib.suppress(TimeoutError):
                payload, source = self._ear.recvfrom(2000)
                if payload[5:13] == self.tag:
                    self._heard.append((payload, source))


class SecuredSwarm:
    """Daemons `r1` and `r2`, an operator, and a stranger; `names` are the robots on the roster."""

    def __init__(
        self,
        folder: Path,
        left: contextlib.ExitStack,
        *,
        names: tuple[str, ...] = ("r1", "r2"),
    ) -> None:
        self.name = unique_swarm()
        self.keys = SwarmKeys(
            folder / "keys", self.name, names, operators=("anna",), viewers=("class",)
        )
        self._folder, self._left, self._lives = folder, left, 0
        self.settings = NetworkSettings(swarm=self.name)
        identity = self.keys["anna"]
        self.tag = tag_of("dev", self.name, identity.info.authority)
        self.stranger = Stranger(self.tag)
        left.callback(self.stranger.close)
        self.daemons = {name: self.spawn(name) for name in ("r1", "r2")}
        for daemon in self.daemons.values():
            daemon.wait_ready()
        self.anna = left.enter_context(Operator(self.settings, identity=identity))

    def spawn(self, robot: str) -> DaemonProcess:
        self._lives += 1
        daemon = DaemonProcess(
            self._folder / f"life{self._lives}",
            swarm=self.name,
            robot=robot,
            endpoint="tcp/127.0.0.1:9",
            options={
                "identity": str(self.keys.folder_of(robot)),
                "state_dir": str(self._folder / "state"),
            },
        )
        return self._left.enter_context(daemon)

    def status(self, robot: str) -> Status:
        """The robot's status, as its operator gets it."""
        found: list[Status] = []

        def look() -> bool:
            status = self.anna.members().members[robot].status
            found[:] = [] if status is None else [status]
            return bool(found)

        wait_until(look, f"{robot} answers")
        return found[0]

    def presence(self, robot: str) -> Presence:
        return self.anna.members().members[robot].presence

    def reset(self, robot: str) -> None:
        view = self.anna.members()
        latches = tuple(view.latches([robot]))
        outcome = self.anna.request(ResetRequest, view.epochs([robot]), ids=latches)
        assert outcome.exit_code == 0, outcome


@pytest.fixture(scope="module")
def swarm(tmp_path_factory: pytest.TempPathFactory) -> Iterator[SecuredSwarm]:
    with contextlib.ExitStack() as left:
        yield SecuredSwarm(tmp_path_factory.mktemp("secured"), left)


def test_what_strangers_forge_and_replay_moves_no_daemon(swarm: SecuredSwarm) -> None:
    stranger, r1 = swarm.stranger, swarm.stranger.address_of("r1")
    alive = swarm.anna.members().alive
    assert set(alive) == {"r1", "r2"}
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
            _dropped(swarm.status("r1"), "unsigned") >= len(forged)
            and _dropped(swarm.status("r1"), "forged") >= len(forged)
        ),
        "all are counted",
    )
    assert swarm.status("r1").state is State.IDLE
    assert "refused datagrams: " in swarm.daemons["r1"].text()
    stranger.mouth.setblocking(False)
    with pytest.raises(BlockingIOError):
        stranger.mouth.recv(2000)  # no question was answered

    # A robot that is gone stays gone, whatever was recorded of it.
    swarm.daemons["r2"].kill()
    wait_until(lambda: swarm.presence("r2") is Presence.FAILED, "r2 is gone")
    before = _dropped(swarm.status("r1"), "unproven")
    beacons = [raw for body, raw, _ in stranger.recorded(Beacon) if body.robot == "r2"]  # type: ignore[union-attr]
    for raw in beacons:
        stranger.mouth.sendto(raw, r1)
        stranger.mouth.sendto(raw, (GROUP4, GROUP_PORT))
    wait_until(lambda: _dropped(swarm.status("r1"), "unproven") > before, "it is counted")
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
        return _dropped(swarm.status("r1"), "repeated") > 0

    # Until r1 has heard that r2 was reset, the latches of r2 are no repetition.
    wait_until(replay, "latches are counted")
    assert swarm.status("r1").state is State.IDLE

    # A robot that restarts knows what it heard before.
    swarm.daemons["r1"].kill()
    again = swarm.spawn("r1").wait_ready()
    r1 = stranger.address_of("r1")
    wait_until(lambda: stranger.address_of("r1") != r1 or _answers(swarm, "r1"), "r1 is back")
    for raw in estops:
        stranger.mouth.sendto(raw, stranger.address_of("r1"))
    wait_until(lambda: "refused a replayed estop of anna" in again.text(), "it is logged")
    assert swarm.status("r1").state is State.IDLE
    # The operator's next stop counts.
    assert swarm.anna.send_stop("estop").exit_code == 0
    assert swarm.status("r1").state is State.ESTOPPED


def _answers(swarm: SecuredSwarm, robot: str) -> bool:
    return robot in swarm.anna.members().answered


def _dropped(status: Status, kind: str) -> int:
    return status.health.dropped.get(f"datagram:{kind}", 0)
