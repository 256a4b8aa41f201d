"""Records that spread among robots (goals, pattern manifests): issuer, targets, order and digest.

On every robot the greater record counts, in any order of arrival, so no coordinator is needed.
Records are ordered by generation, issuer and signed bytes, never by the signature.
"""

from __future__ import annotations

import fnmatch
import hashlib
from collections.abc import Collection
from enum import IntEnum
from typing import Annotated

from msgspec import Meta, Struct

from swarmd.core.bounds import Name

DIGEST_BYTES = 6
Digest = Annotated[bytes, Meta(max_length=DIGEST_BYTES)]
LABEL = "label:"

Target = Annotated[str, Meta(min_length=1, max_length=70)]
"""A robot's name, a shell-style pattern of names, or `label:` and a label."""


class RecordKind(IntEnum):
    """The kinds of data that spread among robots; the value is the index of the digest in a beacon.

    Append only.
    """

    LATCH = 0
    GOAL = 1
    PATTERN = 2
    INCIDENT = 3


class Record(Struct, frozen=True, kw_only=True):
    """The common fields of records. `issuer`: the operator. `targets` empty: all robots."""

    generation: Annotated[int, Meta(ge=1, le=2**32 - 1)]
    issuer: Name
    targets: tuple[Target, ...] = ()

    @property
    def order(self) -> tuple[int, str]:
        """The first part of the sort key of records; signed bytes follow. The greater counts."""
        return self.generation, self.issuer

    def is_for(self, robot: str, labels: Collection[str]) -> bool:
        """True if the record targets a robot with these labels."""
        return not self.targets or any(
            target.removeprefix(LABEL) in labels
            if target.startswith(LABEL)
            else fnmatch.fnmatchcase(robot, target)
            for target in self.targets
        )


def digest_of(generation: int, content: bytes) -> bytes:
    """The digest for beacons: the generation (4 bytes) and a hash of the signed bytes (2 bytes)."""
    hashed = hashlib.blake2b(content, digest_size=DIGEST_BYTES - 4).digest()
    return generation.to_bytes(4, "big") + hashed


def generation_of(digest: bytes) -> int:
    """The generation in a digest; 0 without a record."""
    return int.from_bytes(digest[:4], "big") if len(digest) == DIGEST_BYTES else 0


def may_replace(digest: bytes, own: bytes) -> bool:
    """True if the record with this digest may be greater than the record with the digest `own`."""
    is_digest = len(digest) == DIGEST_BYTES and digest != own
    return is_digest and generation_of(digest) >= generation_of(own)
