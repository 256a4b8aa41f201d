"""The symmetric keys that sign datagrams, and how they derive from the secrets of a swarm. Pure.

Beacons and messages are too many for asymmetric signatures, so that a key signs for a class of
readers: a reader that verifies could also sign, but only toward the same class. A robot signs each
group datagram once for robots, once for operators and once for viewers. An operator or viewer
signs with a key of its own name. A robot signs its answers to an operator with a key of that pair.

Keys derive by keyed BLAKE2b (RFC 7693) from the swarm's secret, which changes with each generation
of the roster and which robots alone hold, and from a secret of each robot.
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
    """What one name holds at one generation of the roster; empty: not for its role.

    `secret`: the swarm's, of robots. `robots`, `operators`, `viewers`: the keys of the classes.
    `own`: with which an operator or viewer signs. `answer_secret`: of this robot. `answers`: the
    keys of an operator or viewer with each robot.
    """

    generation: int
    secret: Secret = b""
    robots: Key = b""
    operators: Key = b""
    viewers: Key = b""
    own: Key = b""
    answer_secret: Secret = b""
    answers: dict[str, Key] = {}

    def of_name(self, name: str) -> bytes:
        """The key with which the operator or viewer `name` signs; for robots."""
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
    """The keys of a robot at a generation with that secret of the swarm."""
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
    """SHA-256 of the keys of an operator or viewer that change with the roster, which holds it."""
    content = keys.generation, keys.operators, keys.viewers, keys.own
    return hashlib.sha256(msgspec.msgpack.encode(content)).digest()
