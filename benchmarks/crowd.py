"""Robots that are nothing but their answers to a look: 100 daemons do not fit a machine.

One process has a socket for each of them. It answers each `Solicit` with a beacon, the status and
the member list of each robot, as its own protocol would, and acks nothing. The answers are made
before; so what is measured beside it is `swarmctl`.
"""

from __future__ import annotations

import os
import secrets
import select
import socket
import subprocess
import sys
from collections.abc import Sequence
from typing import Self

from msgspec.structs import replace

from swarmd.core import codec
from swarmd.core.messages import Presence, State, Status
from swarmd.link.carriers.udp import UdpCarrier
from swarmd.link.datagram import (
    PRESENCES,
    STATES,
    Address,
    Beacon,
    MemberList,
    MemberReport,
    Solicit,
    in_parts,
    pack,
    status_parts,
    tag_of,
    unpack,
)
from swarmd.link.settings import NetworkSettings
from tests.support.statuses import status

ALIVE = PRESENCES.index(Presence.ALIVE)


class AnsweringRobot:
    """One robot: its socket, and its answers."""

    def __init__(self, number: int, tag: bytes) -> None:
        self.name = f"r{number:03d}"
        self.instance = number.to_bytes(6, "big")
        self.socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self.socket.bind(("127.0.0.1", 0))
        self._tag = tag
        self._sequence = 0
        self._status = codec.encode(self._told())
        self._lists: Sequence[MemberList] = ()

    def _told(self) -> Status:
        return status(self.name, instance=self.instance.hex(), report={"neighbors": 8})

    @property
    def report(self) -> MemberReport:
        """What the others list of it."""
        host, port = self.socket.getsockname()
        return MemberReport(
            robot=self.name, instance=self.instance, presence=ALIVE, age=300, host=host, port=port
        )

    def know(self, reports: Sequence[MemberReport]) -> None:
        """List all robots but itself."""
        parts = in_parts(tuple(one for one in reports if one.robot != self.name))
        self._lists = [
            MemberList(
                robot=self.name,
                instance=self.instance,
                members=members,
                part=number,
                parts=len(parts),
            )
            for number, (members, _) in enumerate(parts)
        ]

    def answer(self, solicit: Solicit, source: Address) -> None:
        """Send what the solicit asks for."""
        self._sequence += 1
        told = []
        if solicit.wants_status:
            told = status_parts(self.name, self.instance, solicit.echo, self._status)
        beacon = Beacon(
            robot=self.name,
            instance=self.instance,
            sequence=self._sequence,
            wire=codec.VERSION,
            state=STATES.index(State.RUNNING),
            revision=1,
            echo=solicit.echo,
            version="1.0",
            clock=1000,
            status_parts=len(told),
        )
        lists = [replace(one, echo=solicit.echo) for one in self._lists]
        for body in (beacon, *told, *(lists if solicit.wants_members else ())):
            self.socket.sendto(pack(self._tag, body), source)


class Crowd:
    """A context manager: `count` answering robots of a swarm, in a process of their own."""

    def __init__(self, count: int) -> None:
        self.swarm = f"crowd-{secrets.token_hex(4)}"
        self._command = [sys.executable, "-m", "benchmarks.crowd", str(count), self.swarm]

    def __enter__(self) -> Self:
        self._process = subprocess.Popen(
            self._command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
        )
        assert self._process.stdout is not None
        self._process.stdout.readline()  # it listens
        return self

    def __exit__(self, *_: object) -> None:
        self._process.communicate(timeout=10.0)  # ends with its standard input


def serve(count: int, swarm: str) -> None:
    """Answer until the standard input ends."""
    settings = NetworkSettings(swarm=swarm)
    tag = tag_of(settings.profile, swarm)
    robots = [AnsweringRobot(number, tag) for number in range(1, count + 1)]
    reports = [one.report for one in robots]
    for robot in robots:
        robot.know(reports)

    def on_solicit(payload: bytes, source: Address, waited: float) -> None:
        body = unpack(tag, payload)
        if isinstance(body, Solicit):
            for robot in robots:
                robot.answer(body, source)

    carrier = UdpCarrier(settings, tag)
    carrier.start_thread(on_solicit)
    poll = select.poll()
    by_file = {robot.socket.fileno(): robot for robot in robots}
    for file in (0, *by_file):
        poll.register(file, select.POLLIN)
    print("ready", flush=True)
    while True:
        ready = [file for file, _ in poll.poll()]
        if 0 in ready:  # nothing is written there: it has ended
            break
        for file in ready:
            payload, source = by_file[file].socket.recvfrom(2048)
            body = unpack(tag, payload)
            if isinstance(body, Solicit):
                by_file[file].answer(body, source)
    carrier.close()


if __name__ == "__main__":
    os.environ["OPENBLAS_NUM_THREADS"] = "1"
    serve(int(sys.argv[1]), sys.argv[2])
