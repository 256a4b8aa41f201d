"""A bundle: one file with an identity and the settings of its swarm, for transfer to a machine.

Layout: a line of text with the format, the SHA-256 digest of the body, and the body as msgpack. The
digest detects damage. A bundle contains a private key, and must be kept as secret as that key. A
bundle contains no file names: an installation writes only files of fixed names.
"""

from __future__ import annotations

import hashlib
from dataclasses import dataclass
from pathlib import Path

import msgspec
from msgspec import field

from swarmd.core.codec import decode
from swarmd.core.errors import CodecError, ConfigError
from swarmd.core.files import read_regular
from swarmd.core.keys import is_id
from swarmd.link.keys.identity import Issued, write_private
from swarmd.link.keys.roster import Roster, read_roster

FORMAT = b"swarmd bundle 1\n"
_FORMAT_PREFIX = b"swarmd bundle "  # of the bundles of all versions
MAX_BUNDLE = 1024 * 1024
SUFFIX = ".bundle"
_DIGEST_BYTES = 32


class Bundle(Issued, frozen=True, kw_only=True):
    """An identity with `settings`: keys of swarm.yaml, which the installation must check."""

    settings: dict[str, object] = field(default_factory=dict)


@dataclass(frozen=True, slots=True)
class OpenedBundle:
    """A bundle with its roster, whose signature was verified."""

    bundle: Bundle
    roster: Roster


_bundle = msgspec.msgpack.Decoder(Bundle)


def pack_bundle(bundle: Bundle) -> bytes:
    """The content of a bundle's file. ConfigError if it is too large."""
    body = msgspec.msgpack.encode(bundle)
    packed = FORMAT + hashlib.sha256(body).digest() + body
    if len(packed) > MAX_BUNDLE:
        raise ConfigError(f"a bundle has {len(packed)} bytes; at most {MAX_BUNDLE} are read")
    return packed


def unpack_bundle(data: bytes) -> OpenedBundle:
    """Decode the content of a bundle's file, and check that its parts belong together.

    A bundle is a line with the format, the SHA-256 of the rest, and an identity with its roster.
    The authority that the bundle names must have signed the roster. The roster must list the holder
    of the identity, in the identity's role. CodecError in one line if a check fails, or if `data`
    is no such bundle.
    """
    # 1. Format and digest.
    if len(data) > MAX_BUNDLE:
        raise CodecError(f"more than {MAX_BUNDLE} bytes: not a bundle")
    if not data.startswith(FORMAT):
        if data.startswith(_FORMAT_PREFIX):
            raise CodecError("a bundle of another format; install with the swarmd that made it")
        raise CodecError("not a bundle; make one with `swarmctl keys bundle`")
    digest = data[len(FORMAT) : len(FORMAT) + _DIGEST_BYTES]
    body = data[len(FORMAT) + _DIGEST_BYTES :]
    if hashlib.sha256(body).digest() != digest:
        raise CodecError("damaged or cut short; copy it again")

    # 2. Roster, name, role, and generation of the keys.
    bundle = decode(_bundle, body, "a bundle")
    info = bundle.info
    roster = read_roster(bundle.roster.roster, info.authority)
    if roster.swarm != info.swarm or roster.role_of(info.name) is not info.role:
        raise CodecError(f"{info.name} is not on the bundle's roster as {info.role}")
    if bundle.roster.datagram_keys.generation != roster.generation:
        raise CodecError("roster and keys of the bundle are of different generations")
    if not all(is_id(name) for name in (info.swarm, info.name)):
        raise CodecError("a bundle whose swarm or holder has an invalid name")
    return OpenedBundle(bundle, roster)


def read_bundle(path: Path) -> OpenedBundle:
    """The bundle in a file. ConfigError in one line with the path."""
    try:
        data = read_regular(path)
    except OSError as error:
        raise ConfigError(f"{path}: cannot be read: {error.strerror}") from error
    try:
        return unpack_bundle(data)
    except CodecError as error:
        raise ConfigError(f"{path}: {error}") from error


def write_bundle(path: Path, bundle: Bundle) -> None:
    """Write a bundle, readable only by the owner, whole or not at all."""
    write_private(path, pack_bundle(bundle))
