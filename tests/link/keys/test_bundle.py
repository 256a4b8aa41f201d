"""Bundles: what is read back, and that damage, other formats and contradictions are refused."""

from __future__ import annotations

import hashlib
import stat
from pathlib import Path

import msgspec
import pytest

from swarmd.core.errors import CodecError, ConfigError
from swarmd.link.keys.authority import Authority
from swarmd.link.keys.bundle import (
    FORMAT,
    MAX_BUNDLE,
    Bundle,
    pack_bundle,
    read_bundle,
    unpack_bundle,
    write_bundle,
)
from swarmd.link.keys.roster import Role


def bundle_of(authority: Authority, name: str, **settings: object) -> Bundle:
    issued = authority.issue(name)
    return Bundle(
        info=issued.info,
        certificate=issued.certificate,
        key=issued.key,
        authority=issued.authority,
        roster=issued.roster,
        settings=settings,
    )


@pytest.fixture(scope="module")
def authority(tmp_path_factory: pytest.TempPathFactory) -> Authority:
    made = Authority.create(tmp_path_factory.mktemp("keys") / "authority", "meadow")
    made.change(add={"r01": Role.ROBOT, "r02": Role.ROBOT, "alice": Role.OPERATOR})
    return made


def signed(body: bytes) -> bytes:
    """A bundle's file with a right digest of any body."""
    return FORMAT + hashlib.sha256(body).digest() + body


def test_a_bundle_is_read_as_it_was_written(authority: Authority, tmp_path: Path) -> None:
    made = bundle_of(authority, "r01", profile="field", interface="wlan0")
    path = tmp_path / "r01.bundle"
    write_bundle(path, made)
    opened = read_bundle(path)
    assert opened.bundle == made
    assert opened.roster == authority.roster
    assert stat.S_IMODE(path.stat().st_mode) == 0o600


def test_every_truncation_is_refused(authority: Authority) -> None:
    data = pack_bundle(bundle_of(authority, "r01"))
    for end in range(len(data)):
        with pytest.raises(CodecError):
            unpack_bundle(data[:end])


def test_every_flipped_byte_is_refused(authority: Authority) -> None:
    data = bytearray(pack_bundle(bundle_of(authority, "r01")))
    for at in range(len(data)):
        data[at] ^= 0x20
        with pytest.raises(CodecError):
            unpack_bundle(bytes(data))
        data[at] ^= 0x20


def test_another_format_is_named(authority: Authority) -> None:
    data = pack_bundle(bundle_of(authority, "r01"))
    with pytest.raises(CodecError, match="another format"):
        unpack_bundle(data.replace(b"bundle 1\n", b"bundle 2\n"))
    with pytest.raises(CodecError, match="not a bundle"):
        unpack_bundle(b"PK\x03\x04")


def test_large_files_and_settings_are_refused(authority: Authority, tmp_path: Path) -> None:
    path = tmp_path / "large"
    path.write_bytes(FORMAT + bytes(MAX_BUNDLE))
    with pytest.raises(ConfigError, match="not a bundle"):
        read_bundle(path)
    with pytest.raises(ConfigError, match="at most"):
        pack_bundle(bundle_of(authority, "r01", labels="x" * MAX_BUNDLE))


def test_what_does_not_belong_together_is_refused(authority: Authority) -> None:
    r01, alice = bundle_of(authority, "r01"), bundle_of(authority, "alice")
    replace, encode = msgspec.structs.replace, msgspec.msgpack.encode
    newer = msgspec.structs.replace(r01.roster.datagram_keys, generation=9)
    for wrong in (
        replace(r01, info=alice.info, roster=replace(r01.roster, roster=b"")),
        replace(r01, info=replace(r01.info, name="r03")),
        replace(r01, info=replace(r01.info, role=Role.OPERATOR)),
        replace(r01, info=replace(r01.info, authority=bytes(64))),
        replace(r01, roster=replace(r01.roster, datagram_keys=newer)),
    ):
        with pytest.raises(CodecError):
            unpack_bundle(signed(encode(wrong)))


@pytest.mark.parametrize("name", ["../../etc/cron.d/x", "/etc/passwd", "a/b", "", "A", "a\n"])
def test_names_cannot_lead_out_of_a_folder(authority: Authority, name: str) -> None:
    good = bundle_of(authority, "r01")
    for field in ("swarm", "name"):
        info = msgspec.structs.replace(good.info, **{field: name})
        with pytest.raises(CodecError):
            unpack_bundle(signed(msgspec.msgpack.encode(msgspec.structs.replace(good, info=info))))


@pytest.mark.parametrize("body", [b"", b"\x80", b"\x91" * 5000, b"\xc1", b"\xdf\xff\xff\xff\xff"])
def test_a_body_that_is_no_bundle_is_refused(body: bytes) -> None:
    with pytest.raises(CodecError):
        unpack_bundle(signed(body))
