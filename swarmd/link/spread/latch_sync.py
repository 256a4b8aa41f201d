"""How swarm-wide emergency stops spread: beacons show digests, and robots ask for latches. Pure.

A latch holds an emergency stop until a reset. A beacon shows the digest of its sender's latches. If
this digest differs from the digest of this robot's latches, this robot asks the sender for its
latches, until an answer with the digest has come. So a robot that joins, restarts or was cut off
takes over the latches that it missed. While all digests are equal, no latches are sent.
"""

from __future__ import annotations

import hashlib
from collections.abc import Mapping

import msgspec
from msgspec.structs import asdict, replace

from swarmd.core.bounds import keep_newest
from swarmd.core.messages import Latch
from swarmd.core.record import DIGEST_BYTES
from swarmd.link.datagram import Latches
from swarmd.link.spread.asks import MAX_KNOWN, Asks

ASK_PERIOD = 0.25  # between requests to one robot, in s
STRANGERS_ASKED = 4  # strangers that are asked in one period
MAX_PARTIAL = 64
MAX_LATCHES = 64
ROOM = 1200  # bytes for latches in a datagram
# bytes of the issuer and of any other text as they are sent
MAX_ISSUER = 128
MAX_TEXT = 256


def digest_of(latches: Mapping[str, Latch]) -> bytes:
    """The digest of the swarm-wide latches; empty without any."""
    names = sorted(name for name, latch in latches.items() if latch.scope == "swarm")
    if not names:
        return b""
    return hashlib.blake2b("\n".join(names).encode(), digest_size=DIGEST_BYTES).digest()


def latch_parts(robot: str, instance: bytes, latches: Mapping[str, Latch]) -> list[Latches]:
    """The swarm-wide latches of a robot in datagrams that fit."""
    digest = digest_of(latches)
    room = 0
    parts: list[dict[str, Latch]] = []
    for name, latch in sorted(latches.items()):
        if latch.scope != "swarm":
            continue
        texts = {key: text for key, text in asdict(latch).items() if isinstance(text, str)}
        texts = {key: _cut(text, MAX_TEXT) for key, text in texts.items()}
        sent = replace(latch, **{**texts, "issuer": _cut(latch.issuer, MAX_ISSUER)})
        size = len(msgspec.msgpack.encode({name: sent}))
        if not parts or size > room:
            parts.append({})
            room = ROOM
        parts[-1][name] = sent
        room -= size
    return [Latches(robot=robot, instance=instance, digest=digest, held=part) for part in parts]


def _cut(text: str, size: int) -> str:
    return text.encode()[:size].decode(errors="ignore")


class LatchSync:
    """Which robots to ask for their latches.

    Strangers, robots heard for a short time only, share a limit of STRANGERS_ASKED per period.
    """

    def __init__(self) -> None:
        self._asks = Asks(ASK_PERIOD, STRANGERS_ASKED)
        self._partial: dict[tuple[bytes, bytes], dict[str, Latch]] = {}
        self._open: set[bytes] = set()  # instances whose latches are wanted

    @property
    def is_open(self) -> bool:
        """True while a robot whose latches are wanted has not answered."""
        return bool(self._open)

    def wants(
        self, instance: bytes, digest: bytes, own: bytes, now: float, *, is_stranger: bool = False
    ) -> bool:
        """Note the digest of a beacon; True if its sender is to be asked for latches now."""
        if not digest or digest == own or self._asks.knows(instance, digest):
            self._open.discard(instance)
            return False
        if len(self._open) < MAX_KNOWN:
            self._open.add(instance)
        is_due = self._asks.take(instance, now, "strangers" if is_stranger else None)
        if is_due:
            self._partial.pop((instance, digest), None)  # parts of an incomplete or forged answer
        return is_due

    def on_latches(self, latches: Latches) -> None:
        """Take a part of an answer; with the last part the robot has answered for its digest."""
        key = latches.instance, latches.digest
        parts = self._partial.get(key, {})
        parts.update(
            (name, latch) for name, latch in latches.held.items() if latch.scope == "swarm"
        )
        is_whole = digest_of(parts) == latches.digest
        if is_whole:
            self._open.discard(latches.instance)
            self._asks.answered(*key)
        if is_whole or len(parts) > MAX_LATCHES:
            self._partial.pop(key, None)
        else:
            keep_newest(self._partial, key, parts, MAX_PARTIAL)
