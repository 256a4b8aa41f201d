"""How swarm-wide emergency stops spread: digests in beacons, latches when they differ. Pure.

A robot whose beacon shows another digest than its own is asked for its latches, until an answer
with that digest has come. So a robot that joins, restarts or was cut off takes over what it missed,
and nothing is sent while all agree.
"""

from __future__ import annotations

import hashlib
from collections.abc import Iterable, Mapping
from typing import Any

import msgspec

from swarmd.core.messages import Latch
from swarmd.network.datagram import DIGEST_BYTES, Latches

ASK_PERIOD = 0.25  # between requests to one robot, in s
STRANGERS_ASKED = 4  # strangers that are asked in one period
MAX_KNOWN = 1024
MAX_PARTIAL = 64
MAX_LATCHES = 64
ROOM = 1200  # bytes for latches in a datagram
MAX_ISSUER, MAX_REASON = 128, 256  # bytes of the texts as they are sent


def digest_of(latches: Mapping[str, Latch]) -> bytes:
    """The digest of the swarm-wide latches; empty without any."""
    names = sorted(name for name, latch in latches.items() if latch.scope == "swarm")
    if not names:
        return b""
    return hashlib.blake2b("\n".join(names).encode(), digest_size=DIGEST_BYTES).digest()


def latch_parts(robot: str, instance: bytes, latches: Mapping[str, Latch]) -> Iterable[Latches]:
    """The swarm-wide latches of a robot in datagrams that fit."""
    digest, room = digest_of(latches), ROOM
    part: dict[str, Latch] = {}
    for name, latch in sorted(latches.items()):
        if latch.scope != "swarm":
            continue
        issuer, reason = _cut(latch.issuer, MAX_ISSUER), _cut(latch.reason, MAX_REASON)
        size = len(name) + len(issuer.encode()) + len(reason.encode()) + 40
        if part and size > room:
            yield Latches(robot=robot, instance=instance, digest=digest, held=part)
            part, room = {}, ROOM
        part[name] = msgspec.structs.replace(latch, issuer=issuer, reason=reason)
        room -= size
    if part:
        yield Latches(robot=robot, instance=instance, digest=digest, held=part)


def _cut(text: str, size: int) -> str:
    return text.encode()[:size].decode(errors="ignore")


class LatchSync:
    """Which robots to ask for their latches; those heard for long before strangers."""

    def __init__(self) -> None:
        self._known: dict[bytes, bytes] = {}  # instance -> the digest that it has answered for
        self._partial: dict[tuple[bytes, bytes], dict[str, Latch]] = {}
        self._asked: dict[bytes, float] = {}
        self._asked_strangers: list[float] = []
        self._open: set[bytes] = set()

    @property
    def is_open(self) -> bool:
        """True while the latches of a robot are wanted that has not answered."""
        return bool(self._open)

    def wants(
        self, instance: bytes, digest: bytes, own: bytes, now: float, *, is_stranger: bool = False
    ) -> bool:
        """True if the sender of a beacon with this digest is to be asked now."""
        if not digest or digest == own or self._known.get(instance) == digest:
            self._open.discard(instance)
            return False
        if len(self._open) < MAX_KNOWN:
            self._open.add(instance)
        if now - self._asked.get(instance, -1e9) < ASK_PERIOD:
            return False
        if is_stranger:
            recent = [at for at in self._asked_strangers if now - at < ASK_PERIOD]
            self._asked_strangers = recent
            if len(recent) >= STRANGERS_ASKED:
                return False
            recent.append(now)
        self._partial.pop((instance, digest), None)  # of an answer that was not whole, or forged
        self._asked.pop(instance, None)
        self._asked[instance] = now
        _bound(self._asked)
        return True

    def on_latches(self, latches: Latches) -> None:
        """An answer came; with the last part its digest is known."""
        key = latches.instance, latches.digest
        parts = self._partial.setdefault(key, {})
        parts.update((name, one) for name, one in latches.held.items() if one.scope == "swarm")
        if digest_of(parts) == latches.digest:
            del self._partial[key]
            self._open.discard(latches.instance)
            self._known.pop(latches.instance, None)
            self._known[latches.instance] = latches.digest
            _bound(self._known)
        elif len(parts) > MAX_LATCHES:
            del self._partial[key]
        while len(self._partial) > MAX_PARTIAL:
            del self._partial[next(iter(self._partial))]


def _bound(table: dict[bytes, Any]) -> None:
    while len(table) > MAX_KNOWN:
        del table[next(iter(table))]
