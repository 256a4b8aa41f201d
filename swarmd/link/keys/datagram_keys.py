"""The symmetric keys that sign datagrams, and their derivation from the swarm's secrets. Pure.

Beacons and messages are too frequent for asymmetric signatures, so datagrams are signed with
symmetric keys. Who can verify with a symmetric key can also forge with it. So each class of
receivers (robots, operators, viewers) has its own key: a receiver can forge only towards receivers
of its class.

1. A datagram of a robot to all receivers has three signatures, by the keys of the three classes.
2. An operator or viewer signs with the key of its own name, which robots can derive.
3. A robot signs its answer to an operator or viewer with the key that the two share.

Keys are derived by keyed BLAKE2b (RFC 7693) from the swarm's secret and from a secret of each
robot. The swarm's secret changes with each generation of the roster, and only robots have it.
"""

from __future__ import annotations

import hashlib
from typing import Annotated

import msgspec
from msgspec import Meta, Struct

KEY_BYTES = 16
SECRET_BYTES = 32

Key = Annotated[bytes, Meta(max_length=KEY_BYTES)]
Secret = Annotated[bytes, Meta(max_length=SECRET_BYTES)]


class DatagramKeys(Struct, frozen=True, kw_only=True):
    """The keys of a name at one generation of the roster; a key that its role lacks is empty.

    `robots`, `operators`, `viewers`: the keys of the three classes of receivers.
    """

    generation: int
    secret: Secret = b""  # of the swarm; only robots have it
    robots: Key = b""
    operators: Key = b""
    viewers: Key = b""
    own: Key = b""  # with which an operator or viewer signs
    answer_secret: Secret = b""
    """A robot's own secret, from which it derives the keys that it shares with operators and
    viewers."""
    answers: dict[str, Key] = {}  # of an operator or viewer: by robot, the key that both share

    def of_name(self, name: str) -> bytes:
        """The key with which the operator or viewer `name` signs; only a robot can derive it."""
        return derive(self.secret, f"name/{name}")

    def answer_to(self, name: str) -> bytes:
        """The key with which this robot signs its answers to the operator or viewer `name`."""
        return derive(self.answer_secret, f"answer/{name}")


def derive(secret: bytes, purpose: str) -> bytes:
    """A key for a purpose, such as `name/alice`."""
    return hashlib.blake2b(purpose.encode(), key=secret, digest_size=KEY_BYTES).digest()


def robot_secret(master: bytes, robot: str) -> bytes:
    """The answer secret of a robot, from the master secret of the authority."""
    key = f"robot/{robot}".encode()
    return hashlib.blake2b(key, key=master, digest_size=SECRET_BYTES).digest()


def robot_keys(generation: int, secret: bytes, answer_secret: bytes) -> DatagramKeys:
    """The keys of a robot; `secret`: the swarm's secret of this generation."""
    return DatagramKeys(
        generation=generation,
        secret=secret,
        robots=derive(secret, "robots"),
        operators=derive(secret, "operators"),
        viewers=derive(secret, "viewers"),
        answer_secret=answer_secret,
    )


def reader_keys(
    generation: int, secret: bytes, name: str, *, is_operator: bool, answers: dict[str, bytes]
) -> DatagramKeys:
    """The keys of an operator or viewer; a robot and the authority can make them."""
    return DatagramKeys(
        generation=generation,
        operators=derive(secret, "operators") if is_operator else b"",
        viewers=derive(secret, "viewers"),
        own=derive(secret, f"name/{name}"),
        answers=answers,
    )


def reader_digest(keys: DatagramKeys) -> bytes:
    """SHA-256 of the keys of an operator or viewer that change with the roster.

    The roster contains this digest.
    """
    content = keys.generation, keys.operators, keys.viewers, keys.own
    return hashlib.sha256(msgspec.msgpack.encode(content)).digest()
