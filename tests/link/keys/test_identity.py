"""Authority, rosters and identities, with the real library and the robots' own verification."""

from __future__ import annotations

import base64
from pathlib import Path

import msgspec
import pytest
from cryptography.hazmat.primitives import serialization
from cryptography.hazmat.primitives.asymmetric import ec

from swarmd.core.errors import CodecError, ConfigError
from swarmd.link.keys.authority import Authority, IssueRecord, is_encrypted
from swarmd.link.keys.content_signature import Purpose, is_signed_by, sign
from swarmd.link.keys.identity import KEY, ROSTER, load_identity
from swarmd.link.keys.private_keys import load_private_key, pem_of, public_bytes
from swarmd.link.keys.roster import Role, SignedRoster, read_roster
from tests.support.keys import flipped

NAMES = {"r01": Role.ROBOT, "r02": Role.ROBOT, "alice": Role.OPERATOR, "class": Role.VIEWER}


@pytest.fixture
def authority(tmp_path: Path) -> Authority:
    made = Authority.create(tmp_path / "authority", "meadow")
    made.change(add=NAMES)
    return made


def test_an_identity_is_read_as_it_was_issued(authority: Authority, tmp_path: Path) -> None:
    for name, role in NAMES.items():
        authority.issue(name).write(tmp_path / name)
        identity = load_identity(tmp_path / name)
        assert (identity.name, identity.role) == (name, role)
        assert identity.roster == authority.roster
    assert authority.roster.generation == 2


def test_keys_fit_together_by_class_and_pair_and_by_nothing_else(authority: Authority) -> None:
    r01, r02, alice, viewer = (authority.keys_of(n) for n in ("r01", "r02", "alice", "class"))
    assert r01.robots == r02.robots
    assert r01.operators == alice.operators
    assert (alice.robots, viewer.robots, viewer.operators) == (b"", b"", b"")
    assert r01.viewers == viewer.viewers == alice.viewers
    assert r01.of_name("alice") == alice.own != r01.of_name("class")
    assert r01.answer_to("alice") == alice.answers["r01"]
    assert r02.answer_to("alice") != alice.answers["r01"]
    assert (alice.secret, viewer.secret) == (b"", b"")


def test_a_new_generation_changes_the_keys_of_datagrams(authority: Authority) -> None:
    before = authority.keys_of("r01")
    authority.change(remove=["r02"])
    after = authority.keys_of("r01")
    assert (after.generation, after.robots != before.robots) == (3, True)
    assert after.answer_secret == before.answer_secret
    assert Authority(authority.folder).roster == authority.roster


def test_a_roster_with_another_signature_or_content_is_refused(authority: Authority) -> None:
    signed = msgspec.msgpack.decode(authority.signed_roster, type=SignedRoster)
    changed = signed.content.replace(b"r01", b"r03")
    for content, signature in (
        (changed, signed.signature),
        (signed.content, bytes(64)),
        (signed.content, flipped(signed.signature)),
    ):
        with pytest.raises(CodecError, match="signature"):
            read_roster(msgspec.msgpack.encode([content, signature]), authority.public_key)


def test_what_an_operator_signs_is_verified_with_the_key_on_the_roster(
    authority: Authority, tmp_path: Path
) -> None:
    authority.issue("alice").write(tmp_path / "alice")
    signature = sign(load_private_key(tmp_path / "alice" / KEY), Purpose.GOAL, b"goal")
    public = authority.roster.operators["alice"]
    assert is_signed_by(public, Purpose.GOAL, b"goal", signature)
    assert not is_signed_by(public, Purpose.GOAL, b"other", signature)
    assert not is_signed_by(bytes(64), Purpose.GOAL, b"goal", signature)


def test_a_damaged_or_public_identity_is_refused_in_one_line(
    authority: Authority, tmp_path: Path
) -> None:
    authority.issue("r01").write(tmp_path / "r01")
    for name in (KEY, ROSTER):  # the secrets of datagrams are in the roster's file
        (tmp_path / "r01" / name).chmod(0o644)
        with pytest.raises(ConfigError, match=f"{name} can be read by others"):
            load_identity(tmp_path / "r01")
        (tmp_path / "r01" / name).chmod(0o600)
    (tmp_path / "r01" / ROSTER).write_bytes(b"?")
    with pytest.raises(ConfigError, match="install its bundle again"):
        load_identity(tmp_path / "r01")


def test_a_revoked_name_returns_only_after_its_certificate_has_ended(authority: Authority) -> None:
    authority.issue("r01", days=1)
    authority.change(remove=["r01", "r02"])
    with pytest.raises(ConfigError, match="revoked"):
        authority.change(add={"r01": Role.OPERATOR})
    authority.change(add={"r02": Role.ROBOT})  # no certificate of it was ever made
    authority.issue("r02", days=-1)
    authority.change(remove=["r02"])
    assert authority.change(add={"r02": Role.VIEWER}).role_of("r02") is Role.VIEWER


def test_the_authority_remembers_what_each_name_has(authority: Authority) -> None:
    assert authority.record_of("r01") is None
    authority.issue("r01")
    authority.change(remove=["r02"])
    authority.issue("r01", days=200)  # a bundle that is not installed yet
    again = Authority(authority.folder)
    record = again.record_of("r01")
    assert record is not None
    assert record.generation == 2
    again.note_taken(["r01", "alice"])
    taken = Authority(authority.folder)
    assert [taken.record_of(name) for name in ("r01", "alice")] == [
        IssueRecord(record.expires, 3),
        None,
    ]


def test_the_authority_has_the_keys_of_earlier_generations(authority: Authority) -> None:
    before = authority.keys_of("alice")
    authority.change(remove=["r02"])
    file = Authority(authority.folder).roster_of("alice", 2)
    assert file is not None
    assert file.datagram_keys == before
    assert authority.roster_of("alice", 9) is None


def test_changes_of_two_processes_build_on_each_other(authority: Authority) -> None:
    for name in ("alice", "r01"):
        authority.issue(name)
    first, second = Authority(authority.folder), Authority(authority.folder)
    assert first.change(remove=["r02"]).generation == 3
    assert second.change(remove=["class"]).generation == 4
    first.note_taken(["alice", "r01"])  # its roll-out ends after the change of the second one
    now = Authority(authority.folder)
    assert (now.roster.generation, now.roster.names) == (4, ("r01", "alice"))
    record = now.record_of("r01")
    assert record is not None
    assert record.generation == 3
    late = authority.issue("r01", is_recorded=False)
    Authority(authority.folder).change(remove=["r01"])
    with pytest.raises(ConfigError, match="revoked"):
        authority.note_issued(late)


def test_a_full_disk_keeps_the_keys_of_a_name_that_stays(
    authority: Authority, monkeypatch: pytest.MonkeyPatch
) -> None:
    authority.change(add={"bob": Role.OPERATOR})
    operators = authority.roster.operators

    def full(path: Path, content: bytes) -> None:
        raise OSError(28, "No space left on device")

    with monkeypatch.context() as disk:
        disk.setattr("swarmd.link.keys.authority.write_private", full)
        with pytest.raises(OSError, match="No space"):
            authority.change(remove=["alice"])
    assert Authority(authority.folder).change(add={"r09": Role.ROBOT}).operators == operators
    key = load_private_key(authority.folder / "names" / "alice.key")
    assert public_bytes(key.public_key()) == operators["alice"]


_P256, _P239 = bytes.fromhex("06082a8648ce3d030107"), bytes.fromhex("06082a8648ce3d030106")
_KEY = ec.generate_private_key(ec.SECP256R1())
_DER = _KEY.private_bytes(
    serialization.Encoding.DER, serialization.PrivateFormat.PKCS8, serialization.NoEncryption()
)


def _pem(der: bytes) -> bytes:
    body = base64.encodebytes(der).decode()
    return f"-----BEGIN PRIVATE KEY-----\n{body}-----END PRIVATE KEY-----\n".encode()


@pytest.mark.parametrize(
    "content",
    [
        b"",
        b"\xff\x00",
        _pem(_DER)[:90],
        _pem(_DER[:40]),
        _pem(_DER.replace(_P256, _P239)),
        pem_of(ec.generate_private_key(ec.SECP384R1()), None),
        pem_of(_KEY, b"locked"),
    ],
    ids=["empty", "binary", "torn", "short", "unknown_curve", "P-384", "encrypted"],
)
def test_what_is_no_private_key_of_p256_is_refused_in_one_line(
    content: bytes, tmp_path: Path
) -> None:
    (tmp_path / "key.pem").write_bytes(content)
    with pytest.raises(ConfigError) as refused:
        load_private_key(tmp_path / "key.pem")
    assert "key.pem" in str(refused.value)
    assert len(str(refused.value).splitlines()) == 1


def test_a_passphrase_locks_all_private_keys(tmp_path: Path) -> None:
    made = Authority.create(tmp_path / "a", "meadow", b"word")
    made.change(add=NAMES)
    assert is_encrypted(tmp_path / "a")
    for path in (tmp_path / "a").rglob("*.key"):
        assert b"ENCRYPTED" in path.read_bytes()
    for wrong in (None, b"other"):
        with pytest.raises(ConfigError):
            Authority(tmp_path / "a", wrong)
    assert Authority(tmp_path / "a", b"word").issue("r01").info.name == "r01"
