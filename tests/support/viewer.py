"""A visitor of a swarm on this machine, that dials each robot which it hears, for tests."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable

import zenoh

from swarmd.core.errors import CodecError
from swarmd.link.carriers.session import open_operator_session
from swarmd.link.carriers.udp import UdpCarrier
from swarmd.link.datagram import (
    Address,
    Beacon,
    Datagram,
    Flag,
    Solicit,
    pack,
    tag_of,
    unpack,
)
from swarmd.link.settings import NetworkSettings

ANSWER_TIME = 0.1  # s for answers to a question of who is there
LINK_TIME = 1.0  # s for a new link to show its robot's keys


class Viewer:
    """Sees the beacons of a swarm, and asks its robots over Zenoh; changes nothing by itself."""

    def __init__(self, settings: NetworkSettings) -> None:
        self._settings = settings
        self._tag = tag_of(settings.profile, settings.swarm)
        self._sessions: dict[Address, tuple[zenoh.Session, float]] = {}
        self._left: list[zenoh.Session] = []  # of robots that have left
        self._subscriptions: list[tuple[str, Callable[[zenoh.Sample], object]]] = []
        self._entities: list[object] = []
        self._lock = threading.Lock()
        self.beacons: dict[str, Beacon] = {}
        self._robots: dict[str, Address] = {}
        self._addresses: set[Address] = set()
        self.carrier = UdpCarrier(settings, self._tag)
        self.carrier.start_thread(self._on_datagram)

    def __enter__(self) -> Viewer:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        self.carrier.close()
        for session in [*self._left, *(session for session, _ in self._sessions.values())]:
            session.close()

    def send(self, body: Datagram) -> None:
        """Send a datagram to all robots."""
        self.carrier.send(pack(self._tag, body))

    def look(self) -> list[zenoh.Session]:
        """Sessions to all robots that answer now; those that were found earlier stay."""
        self.send(Solicit(echo=1))
        time.sleep(ANSWER_TIME)
        with self._lock:
            for address in self._addresses - self._sessions.keys():
                endpoint = f"tcp/{address[0]}:{address[1]}"
                session = open_operator_session(self._settings, [endpoint])
                self._sessions[address] = session, time.monotonic()
                for key, handler in self._subscriptions:
                    self._entities.append(session.declare_subscriber(key, handler))
            return [session for session, _ in self._sessions.values()]

    def sessions(self, robot: str) -> list[zenoh.Session]:
        """The session to a robot that was heard."""
        found = self._robots.get(robot)
        return [session for address, (session, _) in [*self._sessions.items()] if address == found]

    def get(self, key: str, payload: bytes = b"", *, timeout: float = 5.0) -> list[zenoh.Sample]:
        """The answers to a query; again for as long as a link is new and none has come."""
        while True:
            self.look()
            found = []
            for session, _ in list(self._sessions.values()):
                replies = session.get(
                    key,
                    target=zenoh.QueryTarget.ALL,
                    consolidation=zenoh.ConsolidationMode.NONE,
                    timeout=timeout,
                    payload=payload,
                )
                found += [reply.ok for reply in replies if reply.ok is not None]
            newest = max((since for _, since in [*self._sessions.values()]), default=0.0)
            if found or time.monotonic() - newest > LINK_TIME:
                return found

    def put(self, key: str, payload: bytes) -> None:
        """Put on the links to all robots, without loss."""
        for session in self.look():
            block = zenoh.CongestionControl.BLOCK
            session.put(key, payload, congestion_control=block)

    def subscribe(self, key: str, handler: Callable[[zenoh.Sample], object]) -> None:
        """Subscribe at every robot that is found, now and later by `look`."""
        self._subscriptions.append((key, handler))
        for session, _ in [*self._sessions.values()]:
            self._entities.append(session.declare_subscriber(key, handler))

    def _on_datagram(self, payload: bytes, source: Address, waited: float) -> None:
        try:
            body = unpack(self._tag, payload)
        except CodecError:
            return
        if isinstance(body, Beacon) and not body.flags & Flag.JOINING:
            self.beacons[body.robot] = body
            self._robots[body.robot] = source
            with self._lock:
                if body.flags & Flag.LEFT:
                    self._addresses.discard(source)
                    if (left := self._sessions.pop(source, None)) is not None:
                        self._left.append(left[0])
                else:
                    self._addresses.add(source)
