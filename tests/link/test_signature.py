"""Signatures of datagrams, with keys as the authority makes them."""

from __future__ import annotations

import pytest
from msgspec.structs import replace

from swarmd.core.errors import CodecError
from swarmd.link.datagram import MAX_TRAILER, Ack, Message, Solicit, Stop, pack, tag_of, unpack
from swarmd.link.keys.roster import Role
from swarmd.link.signature import Author, Flaw, Previous, Signer, Trust
from tests.link.keyring import Keyring

TAG = tag_of("dev", "lab", b"k" * 64)
STOP = pack(TAG, Stop(id="s", verb="estop", operator="alice"))
SOLICIT = pack(TAG, Solicit(echo=5))
ALICE = Author(Role.OPERATOR, "alice")
VIEWER = Author(Role.VIEWER, "class")
ROBOT = Author(Role.ROBOT)


@pytest.fixture
def keyring() -> Keyring:
    return Keyring(robots=("r1", "r2"), operators=("alice", "bob"), viewers=("class",))


@pytest.fixture
def trusts(keyring: Keyring) -> dict[str, Trust]:
    return {name: keyring.trust(name) for name in ("r1", "r2", "alice", "bob", "class")}


def test_what_a_robot_sends_to_all_counts_for_every_reader(trusts: dict[str, Trust]) -> None:
    signed = trusts["r1"].signer.sign(SOLICIT)
    assert unpack(TAG, signed) == Solicit(echo=5)
    assert {trust.verifier.verify(signed, 0.0) for trust in trusts.values()} == {ROBOT}
    assert len(signed) - len(SOLICIT) == 29


def test_an_operator_and_a_viewer_sign_with_their_names_for_robots_alone(
    trusts: dict[str, Trust],
) -> None:
    for name, author in (("alice", ALICE), ("class", VIEWER)):
        signed = trusts[name].signer.sign(STOP)
        assert trusts["r1"].verifier.verify(signed, 0.0) == author
        assert trusts["bob"].verifier.verify(signed, 0.0) is Flaw.UNSIGNED


@pytest.mark.parametrize("name", ["r1", "alice"])
def test_every_changed_bit_of_a_datagram_shows(name: str, trusts: dict[str, Trust]) -> None:
    signed = trusts[name].signer.sign(SOLICIT)
    verify = trusts["r2"].verifier.verify
    own = len(SOLICIT) + 5
    for at in range(13, len(signed)):  # the head before the length decides where it is read
        if name == "r1" and at >= own + 8:
            continue  # the tags for other readers
        changed = bytearray(signed)
        changed[at] ^= 0x10
        assert isinstance(verify(bytes(changed), 0.0), Flaw), at
    for size in range(len(signed)):
        assert isinstance(verify(signed[:size], 0.0), Flaw), size
    assert verify(signed + b"\0", 0.0) is Flaw.UNSIGNED


def test_no_key_makes_what_another_one_is_for(keyring: Keyring, trusts: dict[str, Trust]) -> None:
    robot, alice = trusts["r1"].verifier, trusts["alice"].verifier
    keys = keyring.keys("class")
    assert robot.verify(Signer(keys, Role.OPERATOR, "alice").sign(STOP), 0.0) is Flaw.FORGED
    # An operator can sign toward operators, and not toward robots.
    false = Signer(keyring.keys("bob"), Role.ROBOT, "r1").sign(SOLICIT)
    assert alice.verify(false, 0.0) == ROBOT
    assert robot.verify(false, 0.0) is Flaw.FORGED
    # A name that is not on the roster, and one of a robot.
    for name in ("mallory", "r2"):
        named = Signer(replace(keys, own=keyring.keys("r1").of_name(name)), Role.OPERATOR, name)
        assert robot.verify(named.sign(STOP), 0.0) is Flaw.FORGED


def test_an_answer_is_that_of_one_robot_to_one_operator(trusts: dict[str, Trust]) -> None:
    answer = trusts["r1"].signer.sign(SOLICIT, ALICE)
    alice, bob = trusts["alice"].verifier, trusts["bob"].verifier
    assert alice.verify(answer, 0.0) == bob.verify(answer, 0.0) == ROBOT
    assert alice.is_answer_of("r1", answer)
    assert alice.is_answer_of("r2", answer) is False
    assert bob.is_answer_of("r1", answer) is False
    assert alice.is_answer_of("r9", answer) is None
    assert alice.is_answer_of("r1", trusts["r1"].signer.sign(SOLICIT)) is False
    assert trusts["r2"].verifier.verify(answer, 0.0) is Flaw.UNSIGNED
    assert trusts["class"].verifier.verify(answer, 0.0) is Flaw.FORGED


def test_an_ack_is_proven_for_its_operator_whoever_hands_it_on(trusts: dict[str, Trust]) -> None:
    ack = Ack(id="s", robot="r1", instance=b"123456", revision=3, code="applied")
    proven = replace(ack, proof=trusts["r1"].signer.proof(ack, "alice"))
    alice = trusts["alice"].verifier
    assert alice.is_proven(proven)
    assert alice.is_proven(replace(proven, via="r2"))
    assert not trusts["bob"].verifier.is_proven(proven)
    for changed in (
        replace(proven, id="t"),
        replace(proven, robot="r2"),
        replace(proven, code="refused"),
        replace(proven, revision=4),
        replace(proven, proof=b""),
        replace(ack, proof=trusts["r2"].signer.proof(ack, "alice")),
    ):
        assert alice.is_proven(changed) is False
    assert alice.is_proven(replace(proven, robot="r9")) is None


def test_stops_of_the_generation_before_count_for_ten_minutes(keyring: Keyring) -> None:
    old = {name: keyring.trust(name) for name in ("r1", "alice", "class")}
    before = keyring.keys("r1"), keyring.roster
    keyring.renew(remove=("bob",))
    new = Trust.of(keyring.identity("r1"), Previous(*before, until=600.0))
    stop = old["alice"].signer.sign(STOP)
    assert new.verifier.verify(stop, 599.0) == ALICE._replace(is_previous=True)
    assert new.verifier.verify(stop, 600.0) is Flaw.OLDER
    assert new.verifier.verify(old["alice"].signer.sign(SOLICIT), 1.0) is Flaw.OLDER
    assert old["r1"].verifier.verify(keyring.trust("r2").signer.sign(SOLICIT), 0.0) is Flaw.NEWER
    # Keys of pairs do not change, so that an operator with an older roster knows who stopped.
    ack = Ack(id="s", robot="r1", instance=b"123456", revision=3, code="applied")
    proven = replace(ack, proof=new.signer.proof(ack, "alice"))
    assert old["alice"].verifier.is_proven(proven)


def test_the_longest_name_fits_the_room_for_signatures() -> None:
    keyring = Keyring(robots=("r1",), operators=("a" * 63,))
    signed = keyring.trust("a" * 63).signer.sign(SOLICIT)
    assert len(signed) - len(SOLICIT) == MAX_TRAILER
    assert keyring.trust("r1").verifier.verify(signed, 0.0) == Author(Role.OPERATOR, "a" * 63)


def test_a_datagram_that_leaves_no_room_is_refused(trusts: dict[str, Trust]) -> None:
    long = Message(
        robot="r1", instance=b"123456", sequence=1, channel="a/" + "b" * 125, payload=bytes(1024)
    )
    payload = pack(TAG, long)
    assert len(trusts["r1"].signer.sign(payload)) <= 1400
    with pytest.raises(CodecError, match="1400"):
        trusts["r1"].signer.sign(payload + bytes(200))
