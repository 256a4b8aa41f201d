"""Two daemons of a swarm with keys on loopback, whose bases rest; an operator, and a stranger."""

from __future__ import annotations

import contextlib
import functools
import socket
import struct
import threading
from collections.abc import Mapping
from pathlib import Path
from types import UnionType
from typing import Any, Self

from swarmd.core.messages import Presence, Status
from swarmd.core.verbs import ResetRequest
from swarmd.link.carriers.udp import GROUP4, GROUP_PORT
from swarmd.link.datagram import Address, Beacon, Datagram, tag_of, unpack
from swarmd.link.keys.roster import KeyPermit
from swarmd.link.settings import NetworkSettings
from swarmd.operator.session.operator import Operator
from swarmd.operator.session.outcome import Outcome
from tests.support.fake_body import resting_body
from tests.support.keys import SwarmKeys
from tests.support.processes import DaemonProcess, free_endpoint, unique_swarm, wait_until
from tests.support.swarmctl import await_applied, heard_statuses

RUNNING = ("r1", "r2")


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
    """Daemons `r1` and `r2`; `names` are the robots on the roster, `anna` is an operator of it.

    `listens`: `r1` listens at `endpoint`. `bodies`: endpoints of the robots' bodies; a robot
    without one here gets a body that rests. A process is gone once `left` is closed.
    """

    def __init__(
        self,
        folder: Path,
        left: contextlib.ExitStack,
        *,
        names: tuple[str, ...] = RUNNING,
        operators: tuple[str, ...] = ("anna",),
        viewers: tuple[str, ...] = ("class",),
        permits: Mapping[str, KeyPermit] | None = None,
        listens: bool = False,
    ) -> None:
        self.name = unique_swarm()
        self.keys = SwarmKeys(
            folder / "keys",
            self.name,
            names,
            operators=operators,
            viewers=viewers,
            permits=permits,
        )
        self.settings = NetworkSettings(swarm=self.name)
        self.endpoint = free_endpoint()
        self.bodies: dict[str, str] = {}
        self.daemons: dict[str, DaemonProcess] = {}
        self._folder, self._left, self._lives, self._listens = folder, left, 0, listens
        self.tag = tag_of("dev", self.name, self.keys["anna"].info.authority)
        self.stranger = left.enter_context(contextlib.closing(Stranger(self.tag)))

    def start(self) -> Self:
        """Start the daemons; return once they are ready."""
        for robot in RUNNING:
            self.spawn(robot)
        for daemon in self.daemons.values():
            daemon.wait_ready()
        return self

    def spawn(self, robot: str) -> DaemonProcess:
        """A daemon that is starting; the lives of a robot share its state."""
        self._lives += 1
        if robot not in self.bodies:
            body = self._left.enter_context(resting_body(self.name, robot))
            self.bodies[robot] = body.endpoint
        is_there = self._listens and robot == "r1"
        options: dict[str, Any] = {"listen": [self.endpoint]} if is_there else {}
        self.daemons[robot] = daemon = DaemonProcess(
            self._folder / f"life{self._lives}",
            swarm=self.name,
            robot=robot,
            endpoint=self.bodies[robot],
            options={
                "identity": str(self.keys.folder_of(robot)),
                "state_dir": str(self._folder / "state"),
                **options,
            },
        )
        return self._left.enter_context(daemon)

    @functools.cached_property
    def anna(self) -> Operator:
        return self._left.enter_context(self.operator())

    def operator(self, name: str = "anna") -> Operator:
        """An operator that has no link yet, a context manager. `name`: whose key it has."""
        return Operator(self.settings, identity=self.keys[name])

    def status(self, robot: str) -> Status:
        """The robot's status, as its operator gets it."""
        return heard_statuses(self.anna, [robot])[robot]

    def dropped(self, robot: str, kind: str) -> int:
        """How many datagrams of a kind the robot has dropped."""
        return self.status(robot).health.dropped.get(f"datagram:{kind}", 0)

    def presence(self, robot: str) -> Presence:
        found: list[Presence] = []

        def is_listed() -> bool:
            member = self.anna.members().members.get(robot)
            found[:] = [] if member is None else [member.presence]
            return bool(found)

        wait_until(is_listed, f"{robot} is listed")
        return found[0]

    def reset(self, robot: str) -> None:
        """Reset it; asked again if a stall of the machine refused it."""

        def ask() -> Outcome:
            view = self.anna.members()
            latches = tuple(view.latches([robot]))
            return self.anna.request(ResetRequest, view.epochs([robot]), ids=latches)

        await_applied(ask, f"{robot} is reset")

    def calm(self) -> None:
        """No daemon is frozen, and no robot runs or is latched, whatever was before."""
        for daemon in self.daemons.values():
            daemon.thaw()

        def stop() -> Outcome:
            return self.anna.send_stop("stop", select=lambda names: RUNNING, names=RUNNING)

        await_applied(stop, "both robots stop")

        def is_reset() -> bool:
            view = self.anna.members()
            latches = tuple(view.latches(RUNNING))
            if latches:
                self.anna.request(ResetRequest, view.epochs(RUNNING), ids=latches)
            return not latches

        wait_until(is_reset, "no latch is held")
