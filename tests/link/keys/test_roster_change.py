"""Rosters, keys and certificates that an identity takes, and those that it refuses."""

from __future__ import annotations

import shutil
from pathlib import Path

import msgspec
import pytest

from swarmd.core.errors import CodecError, ConfigError
from swarmd.link.keys.authority import Authority
from swarmd.link.keys.datagram_keys import KEY_BYTES
from swarmd.link.keys.identity import Identity, load_identity
from swarmd.link.keys.roster import Role
from swarmd.link.keys.roster_change import (
    SharedRoster,
    is_revoked,
    read_shared,
    share_roster,
    take_answers,
    take_roster,
)
from tests.support.keys import SwarmKeys, flipped


@pytest.fixture
def keys(tmp_path: Path) -> SwarmKeys:
    return SwarmKeys(tmp_path, "meadow", ("r1", "r2"), operators=("alice",), viewers=("class",))


def shared_of(authority: Authority) -> SharedRoster:
    return SharedRoster(authority.signed_roster, authority.secret)


def test_a_robot_takes_a_newer_roster_with_its_keys(keys: SwarmKeys) -> None:
    keys.authority.change(add={"r3": Role.ROBOT})
    taken = take_roster(keys["r1"], shared_of(keys.authority))
    assert (taken.is_changed, taken.is_revoked) == (True, False)
    assert keys["r1"] == taken.identity
    assert taken.identity.datagram_keys == keys.authority.keys_of("r1")


def test_the_same_roster_changes_nothing_and_an_older_one_is_refused(keys: SwarmKeys) -> None:
    old = shared_of(keys.authority)
    assert not take_roster(keys["r1"], old).is_changed
    keys.authority.change(remove=["r2"])
    take_roster(keys["r1"], shared_of(keys.authority))
    before = keys["r1"]
    with pytest.raises(CodecError, match="generation 2"):
        take_roster(keys["r1"], old)
    assert keys["r1"] == before


def test_another_roster_of_the_same_generation_is_refused(keys: SwarmKeys, tmp_path: Path) -> None:
    copy = shutil.copytree(keys.authority.folder, tmp_path / "copy")
    keys.authority.change(add={"r3": Role.ROBOT})
    taken = take_roster(keys["r1"], shared_of(keys.authority)).identity
    older = Authority(copy)
    older.change(add={"r4": Role.ROBOT})
    with pytest.raises(CodecError, match="older copy"):
        take_roster(taken, shared_of(older))


def test_a_roster_with_another_signature_or_encoding_keeps_no_real_one_out(keys: SwarmKeys) -> None:
    """A holder of the roster can make these without the key of the authority."""
    keys.authority.change(add={"r3": Role.ROBOT})
    real, before = shared_of(keys.authority), keys["r1"]
    content, signature = msgspec.msgpack.decode(real.roster)
    other_s = SharedRoster(msgspec.msgpack.encode((content, flipped(signature))), real.secret)
    with pytest.raises(CodecError):
        take_roster(before, other_s)
    assert keys["r1"] == before
    longer = b"\xdc\x00\x02" + real.roster[1:]  # array 16 in place of fixarray
    more = msgspec.msgpack.encode((content, signature, "more"))
    for encoding in (longer, more):
        assert encoding != real.roster
        first = take_roster(before, SharedRoster(encoding, real.secret)).identity
        assert first.signed_roster == real.roster
        assert not take_roster(first, real).is_changed
        assert not take_roster(first, SharedRoster(encoding, real.secret)).is_changed
        issued = keys.authority.issue("r1", days=200)  # the real renewal of that generation
        assert take_roster(first, real, issued.certificate).is_changed
        assert keys["r1"].signed_roster == real.roster


def test_foreign_and_damaged_rosters_are_refused(keys: SwarmKeys, tmp_path: Path) -> None:
    before = keys["r1"]
    other = Authority.create(tmp_path / "other", "meadow")
    other.change(add={"r1": Role.ROBOT, "eve": Role.OPERATOR})
    other.change(add={"r9": Role.ROBOT})
    secret = keys.authority.secret
    keys.authority.change(add={"r3": Role.ROBOT})
    good = shared_of(keys.authority)
    wrong = (
        shared_of(other),
        SharedRoster(good.roster, secret),
        SharedRoster(good.roster),
        SharedRoster(good.roster[:-1], good.secret),
        SharedRoster(bytes(len(good.roster)), good.secret),
    )
    for shared in wrong:
        with pytest.raises(CodecError):
            take_roster(keys["r1"], shared)
    assert keys["r1"] == before


def test_a_robot_that_is_off_the_roster_keeps_no_keys(keys: SwarmKeys) -> None:
    keys.authority.change(remove=["r2"])
    taken = take_roster(keys["r2"], SharedRoster(keys.authority.signed_roster))
    assert taken.is_revoked
    assert is_revoked(keys["r2"])
    assert keys["r2"].datagram_keys.secret == b""
    assert share_roster(keys["r2"], "r1") is None


def test_peers_hand_the_roster_on_by_role(keys: SwarmKeys) -> None:
    authority = keys.authority
    authority.change(add={"r3": Role.ROBOT})
    r1 = take_roster(keys["r1"], shared_of(authority)).identity
    for name in ("r2", "alice", "class"):
        blob = share_roster(r1, name)
        assert blob is not None
        shared = read_shared(blob)
        assert bool(shared.secret) == (name == "r2")
        own = take_roster(keys[name], shared).identity.datagram_keys
        whole = authority.keys_of(name)
        lacks = msgspec.structs.replace(
            whole, answers={n: key for n, key in whole.answers.items() if n != "r3"}
        )
        assert own == lacks  # r1 cannot make the key of a pair with another robot
    assert share_roster(r1, "eve") is None
    blob = share_roster(r1, "alice")
    assert blob is not None
    for end in range(len(blob)):
        with pytest.raises(CodecError):
            read_shared(blob[:end])


def test_a_reader_takes_the_key_with_a_robot_from_that_robot_alone(keys: SwarmKeys) -> None:
    authority = keys.authority
    authority.change(add={"r3": Role.ROBOT, "r4": Role.ROBOT})
    true, before = authority.keys_of("alice"), keys["alice"].datagram_keys.answers
    false = dict.fromkeys(("r1", "r2", "r3", "r4", "ghost"), b"f" * KEY_BYTES)
    handed = SharedRoster(
        authority.signed_roster, keys=msgspec.structs.replace(true, secret=b"s", answers=false)
    )
    taken = take_roster(keys["alice"], handed, giver="r3").identity
    assert taken.datagram_keys.answers == {**before, "r3": false["r3"]}
    assert taken.datagram_keys.secret == b""
    assert keys["alice"] == taken
    taken = take_answers(taken, {"r4": true.answers["r4"], "ghost": b"f" * KEY_BYTES, "r2": b""})
    assert taken.datagram_keys.answers.keys() == {"r1", "r3", "r4"}
    again = take_answers(keys["alice"], {"r2": true.answers["r2"]})
    assert keys["alice"] == again

    authority.change(remove=["r3"])  # what it has handed over goes with it
    handed = SharedRoster(authority.signed_roster, keys=authority.keys_of("alice"))
    after = take_roster(keys["alice"], handed, giver="r3").identity
    whole = authority.keys_of("alice")
    assert after.datagram_keys == whole
    assert keys["alice"].datagram_keys == whole


@pytest.mark.parametrize("field", ["own", "operators", "viewers"])
def test_a_reader_takes_no_changed_keys_of_its_own(field: str, keys: SwarmKeys) -> None:
    """A robot hands them over; the roster shows which they are."""
    keys.authority.change(add={"r3": Role.ROBOT})
    before, true = keys["alice"], keys.authority.keys_of("alice")
    for wrong in (b"", b"f" * KEY_BYTES):
        changed = msgspec.structs.replace(true, **{field: wrong})
        with pytest.raises(CodecError):
            take_roster(before, SharedRoster(keys.authority.signed_roster, keys=changed))
    assert keys["alice"] == before


def test_keys_of_another_roster_are_not_written_over_a_newer_one(keys: SwarmKeys) -> None:
    old = keys["alice"]
    keys.authority.change(remove=["r2"])
    handed = SharedRoster(keys.authority.signed_roster, keys=keys.authority.keys_of("alice"))
    newer = take_roster(old, handed).identity
    assert take_answers(old, {"r2": b"f" * KEY_BYTES}).datagram_keys.answers["r2"] == b"f" * 16
    assert keys["alice"] == newer


def test_a_reader_takes_no_keys_without_their_generation(keys: SwarmKeys) -> None:
    old = keys.authority.keys_of("alice")
    keys.authority.change(add={"r3": Role.ROBOT})
    signed = keys.authority.signed_roster
    for wrong in (SharedRoster(signed), SharedRoster(signed, keys=old), shared_of(keys.authority)):
        with pytest.raises(CodecError):
            take_roster(keys["alice"], wrong)


def test_a_renewed_certificate_replaces_the_one_before(keys: SwarmKeys) -> None:
    issued = keys.authority.issue("r1", days=200)
    taken = take_roster(keys["r1"], shared_of(keys.authority), issued.certificate)
    assert taken.is_changed
    assert keys["r1"].info.expires == issued.info.expires
    assert keys["r1"].certificate.read_bytes() == issued.certificate


def test_a_full_disk_keeps_no_robot_from_a_roster(
    keys: SwarmKeys, monkeypatch: pytest.MonkeyPatch
) -> None:
    before = keys["r1"]
    keys.authority.change(remove=["r2"])
    shared, issued = shared_of(keys.authority), keys.authority.issue("r1", days=200)

    def full(path: Path, content: bytes) -> None:
        raise OSError(28, "No space left on device")

    with monkeypatch.context() as disk:
        for module in ("identity", "roster_change"):
            disk.setattr(f"swarmd.link.keys.{module}.write_private", full)
        taken = take_roster(before, shared, issued.certificate)
        assert (taken.is_changed, taken.identity.roster.generation) == (True, 3)
        assert taken.text.endswith("in memory only: No space left on device")
        again = take_roster(taken.identity, shared)
        assert again.fault.endswith("No space left on device")
    assert keys["r1"] == before
    again = take_roster(taken.identity, shared, issued.certificate)
    assert (again.fault, keys["r1"]) == ("", again.identity)
    assert again.identity.info.expires == issued.info.expires


def test_a_certificate_that_ends_earlier_is_not_taken(keys: SwarmKeys) -> None:
    before, older = keys["r1"], keys.authority.issue("r1", days=30).certificate
    taken = take_roster(before, shared_of(keys.authority), older)
    assert not taken.is_changed
    assert "ends later" in taken.text
    keys.authority.change(add={"r3": Role.ROBOT})
    assert take_roster(before, shared_of(keys.authority), older).is_changed
    assert keys["r1"].info == before.info
    assert keys["r1"].certificate.read_bytes() != older


def test_certificates_of_others_are_refused(keys: SwarmKeys, tmp_path: Path) -> None:
    foreign = SwarmKeys(tmp_path / "foreign", "meadow", ("r1",), operators=("eve",))
    before = keys["r1"]
    ended = keys.authority.issue("r1", days=-1).certificate
    for wrong in (
        keys.authority.issue("r2").certificate,
        foreign.authority.issue("r1").certificate,
        ended,
        b"-----BEGIN CERTIFICATE-----\n",
    ):
        with pytest.raises(ConfigError):
            take_roster(keys["r1"], shared_of(keys.authority), wrong)
    assert keys["r1"] == before
    assert files_of(before) == set(
        ("identity.json", "certificate.pem", "key.pem", "authority.pem", "roster")
    )


def files_of(identity: Identity) -> set[str]:
    return {path.name for path in load_identity(identity.folder).folder.iterdir()}
