"""Bytes that every decoder must refuse, made from a valid message."""

from __future__ import annotations

import random
from collections.abc import Callable

Garbage = Callable[[random.Random, bytes, int], bytes]


def noise(rng: random.Random, valid: bytes, limit: int) -> bytes:
    """Random bytes of another wire version."""
    return bytes([rng.choice((0, *range(2, 256)))]) + rng.randbytes(rng.randrange(limit // 32))


def versioned_noise(rng: random.Random, valid: bytes, limit: int) -> bytes:
    """The right version, then a byte that MessagePack never uses, then random ones."""
    return b"\x01\xc1" + rng.randbytes(rng.randrange(limit // 32))


def truncated(rng: random.Random, valid: bytes, limit: int) -> bytes:
    """The message without its end."""
    return valid[: rng.randrange(1, len(valid))]


def trailed(rng: random.Random, valid: bytes, limit: int) -> bytes:
    """The message with bytes after it."""
    return valid + rng.randbytes(rng.randrange(1, 9))


def oversized(rng: random.Random, valid: bytes, limit: int) -> bytes:
    """The message with more bytes after it than its key may carry."""
    return valid + bytes(limit)


def nested(rng: random.Random, valid: bytes, limit: int) -> bytes:
    """Arrays in arrays, deeper than a stack; the innermost never comes."""
    return b"\x01" + b"\x91" * rng.randrange(min(900, limit // 2), min(60_000, limit))


KINDS: tuple[Garbage, ...] = (noise, versioned_noise, truncated, trailed, oversized, nested)
"""All of them. Arguments: random generator, a valid message, the limit of its key in bytes."""
