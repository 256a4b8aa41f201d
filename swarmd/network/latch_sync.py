"""How swarm-wide emergency stops spread: digests in beacons, latches when they differ. Pure.

A robot whose beacon shows another digest than its own is asked for its latches, until an answer
with that digest has come. So a robot that joins, restarts or was cut off takes over what it missed,
and nothing is sent while all agree.
"""

from __future__ import annotations

import hashlib
from collections.abc import Iterable, Mapping

import msgspec

from swarmd.core.messages import Latch
from swarmd.network.datagram import DIGEST_BYTES, Latches

ASK_PERIOD = 0.5  # between questions, in s
ASKED_AT_ONCE = 2  # robots that are asked in one period
MAX_KNOWN = 1024
PART = 3  # latches in a datagram: their texts have up to 128 and 256 characters
MAX_REASON = 256


def digest_of(latches: Mapping[str, Latch]) -> bytes:
    """The digest of the swarm-wide latches; empty without any."""
    names = sorted(name for name, latch in latches.items() if latch.scope == "swarm")
    if not names:
        return b""
    return hashlib.blake2b("\n".join(names).encode(), digest_size=DIGEST_BYTES).digest()


def latch_parts(robot: str, instance: bytes, latches: Mapping[str, Latch]) -> Iterable[Latches]:
    """The swarm-wide latches of a robot in datagrams that fit."""
    wide = [
        (name, msgspec.structs.replace(latch, reason=latch.reason[:MAX_REASON]))
        for name, latch in sorted(latches.items())
        if latch.scope == "swarm"
    ]
    digest = digest_of(latches)
    for start in range(0, len(wide), PART):
        held = dict(wide[start : start + PART])
        yield Latches(robot=robot, instance=instance, digest=digest, held=held)


class LatchSync:
    """Whom to ask for latches."""

    def __init__(self) -> None:
        self._known: dict[bytes, bytes] = {}  # instance -> the digest that it has answered for
        self._partial: dict[bytes, dict[str, Latch]] = {}
        self._asked: list[float] = []
        self._open: set[bytes] = set()

    @property
    def is_open(self) -> bool:
        """True while the latches of a robot are wanted that has not answered."""
        return bool(self._open)

    def wants(self, instance: bytes, digest: bytes, own: bytes, now: float) -> bool:
        """True if the sender of a beacon with this digest is to be asked now."""
        if not digest or digest == own or self._known.get(instance) == digest:
            self._open.discard(instance)
            return False
        if len(self._open) < MAX_KNOWN:
            self._open.add(instance)
        self._asked = [at for at in self._asked if now - at < ASK_PERIOD]
        if len(self._asked) >= ASKED_AT_ONCE:
            return False
        self._asked.append(now)
        return True

    def on_latches(self, latches: Latches) -> None:
        """An answer came; with the last part its digest is known."""
        parts = self._partial.setdefault(latches.instance, {})
        parts.update(latches.held)
        if digest_of(parts) == latches.digest or len(parts) > 64:
            del self._partial[latches.instance]
            self._open.discard(latches.instance)
            self._known.pop(latches.instance, None)
            self._known[latches.instance] = latches.digest
        for table in (self._known, self._partial):
            while len(table) > MAX_KNOWN:
                del table[next(iter(table))]
