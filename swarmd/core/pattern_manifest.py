"""Manifests of the patterns that operators push to a swarm: their order, and their table. Pure.

A manifest names code by its SHA-256, and the robots that must have this code. Every robot keeps a
table of all manifests, also of manifests for other robots, and merges the tables of its peers into
this table. Two robots that know the same manifests have the same table, in any order of arrival.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping
from dataclasses import dataclass, field
from typing import Annotated, Literal

import msgspec
from msgspec import Meta, Struct

from swarmd.core import record
from swarmd.core.bounds import Id
from swarmd.core.codec import decode
from swarmd.core.errors import CodecError
from swarmd.core.record import Record, Target

MAX_CODE = 1024 * 1024
"""Bytes of one pushed pattern."""
MAX_MANIFEST = 8 * 1024
MAX_TARGETS = 256
MAX_TABLE = 256
"""Manifests of a table. Beyond it the oldest removals are forgotten, then the oldest manifests."""


class PatternManifest(Record, frozen=True, kw_only=True):
    """One push, or the removal, of a pushed pattern.

    `version`: only for display. `digest`: the SHA-256 of the code. `size`: of the code in bytes.
    `value`: `module:Class` of a wheel. `replaces`: the pushed pattern may replace a pattern of the
    same name from a package or from `plugin_dir`.
    """

    swarm: Id
    name: Id
    targets: Annotated[tuple[Target, ...], Meta(max_length=MAX_TARGETS)] = ()
    kind: Literal["file", "wheel", "removed"]
    version: Annotated[str, Meta(max_length=32)] = ""
    digest: Annotated[bytes, Meta(max_length=32)] = b""
    size: Annotated[int, Meta(ge=0, le=MAX_CODE)] = 0
    value: Annotated[str, Meta(max_length=256)] = ""
    replaces: bool = False

    @property
    def label(self) -> str:
        """Name, version and start of the digest, such as `flock 2 (ab12cd34)`."""
        return f"{self.name} {self.version} ({self.digest.hex()[:8]})".replace("  ", " ")


class Signed(Struct, frozen=True, array_like=True):
    """The bytes of a manifest, and the issuer's signature of them; empty without keys."""

    content: Annotated[bytes, Meta(max_length=MAX_MANIFEST)]
    signature: Annotated[bytes, Meta(max_length=64)] = b""


@dataclass(frozen=True, slots=True)
class Entry:
    """A manifest of the table with its signature; equal manifests make equal entries."""

    signed: Signed = field(compare=False)
    manifest: PatternManifest = field(compare=False)
    content: bytes = field(repr=False)

    @property
    def order(self) -> tuple[int, str, bytes]:
        """The sort key of manifests; the greater manifest counts."""
        return *self.manifest.order, self.content

    @property
    def is_removal(self) -> bool:
        """True for the removal of a pushed pattern."""
        return self.manifest.kind == "removed"

    def covers(self, lesser: Entry) -> bool:
        """True if no robot needs the lesser entry any more because of this entry."""
        mine = self.manifest
        its = lesser.manifest
        return mine.name == its.name and (not mine.targets or mine.targets == its.targets)


Table = tuple[Entry, ...]
"""Entries in their order, the greatest first."""
Manifests = Annotated[tuple[Signed, ...], Meta(max_length=2 * MAX_TABLE)]
"""A table as it is sent and written."""

_manifest = msgspec.msgpack.Decoder(PatternManifest)
_table = msgspec.msgpack.Decoder(Manifests)
_encoder = msgspec.msgpack.Encoder()


def encode_manifest(manifest: PatternManifest) -> bytes:
    """The bytes that an operator signs. CodecError beyond MAX_MANIFEST and MAX_TARGETS."""
    content = _encoder.encode(manifest)
    if len(content) > MAX_MANIFEST or len(manifest.targets) > MAX_TARGETS:
        raise CodecError(
            f"a manifest of {len(content)} bytes for {len(manifest.targets)} targets;"
            f" at most {MAX_MANIFEST} for {MAX_TARGETS}: use globs"
        )
    return content


def read_entry(signed: Signed) -> Entry:
    """The entry of a signed manifest; its signature is not checked. CodecError if malformed."""
    manifest = decode(_manifest, signed.content, "a manifest")
    if manifest.kind != "removed" and len(manifest.digest) != 32:
        raise CodecError(f"the manifest of {manifest.name} lacks the SHA-256 of its code")
    if _encoder.encode(manifest) != signed.content:
        raise CodecError(f"the manifest of {manifest.name} is not encoded as its issuer encodes it")
    return Entry(signed, manifest, signed.content)


def encode_table(table: Iterable[Entry]) -> bytes:
    """The bytes of a table."""
    return _encoder.encode([entry.signed for entry in table])


def decode_table(content: bytes) -> Table:
    """The entries in these bytes; signatures are not checked. CodecError if malformed."""
    return read_table(decode(_table, content, "a table of pushed patterns"))


def read_table(manifests: Manifests) -> Table:
    """The entries of these manifests, as `decode_table`."""
    return merged((), map(read_entry, manifests))


def merged(table: Iterable[Entry], others: Iterable[Entry]) -> Table:
    """The union of two tables, without entries that a greater entry covers."""
    kept: list[Entry] = []
    for entry in sorted({*table, *others}, key=lambda entry: entry.order, reverse=True):
        if not any(greater.covers(entry) for greater in kept):
            kept.append(entry)
    while len(kept) > MAX_TABLE:
        removals = [entry for entry in kept if entry.is_removal]
        kept.remove(removals[-1] if removals else kept[-1])
    return tuple(kept)


def wanted_by(robot: str, labels: Collection[str], table: Table) -> Mapping[str, Entry]:
    """By name: the greatest entry that targets a robot with these labels, removals included."""
    entries: dict[str, Entry] = {}
    for entry in table:
        if entry.manifest.is_for(robot, labels):
            entries.setdefault(entry.manifest.name, entry)
    return entries


def greatest_generation(table: Table) -> int:
    """The greatest generation of a table; 0 if it is empty."""
    return table[0].manifest.generation if table else 0


def digest_of(table: Table) -> bytes:
    """The digest of a table, for beacons: greatest generation and hash; empty without entries."""
    if not table:
        return b""
    content = _encoder.encode([entry.content for entry in table])
    return record.digest_of(greatest_generation(table), content)
