"""What an operator takes from the robots of a secured swarm."""

from __future__ import annotations

import pytest
from msgspec.structs import replace

from swarmd.network.answers import Answers
from swarmd.network.datagram import (
    Ack,
    Address,
    Beacon,
    Datagram,
    Flag,
    MemberList,
    MemberReport,
    pack,
    tag_of,
)
from swarmd.network.signature import Author
from swarmd.security.roster import Role
from tests.network.keyring import Keyring

TAG = tag_of("field", "lab")
ROBOT: Address = ("10.0.0.1", 7440)
ANNA = Author(Role.OPERATOR, "anna")
BEACON = Beacon(robot="r1", instance=b"123456", sequence=10, wire=1, state=0, revision=1)
LIST = MemberList(
    robot="r1",
    instance=b"123456",
    echo=7,
    members=tuple(
        MemberReport(robot=name, instance=b"abcdef", presence=0, age=1) for name in ("r2", "ghost")
    ),
    roster=("r2", "ghost"),
)
ACK = Ack(id="s", robot="r1", instance=b"123456", revision=1, code="applied")


@pytest.fixture
def keyring() -> Keyring:
    return Keyring(("r1", "r2"), operators=("anna", "bob"))


class Rig:
    """The operator anna, who has asked with echo 7 at time 0."""

    def __init__(self, keyring: Keyring) -> None:
        self.keyring = keyring
        self.hints: list[tuple[str, Address, int]] = []
        self.answers = Answers(keyring.identity("anna"), 3.0, lambda *hint: self.hints.append(hint))
        self.answers.liveness.note_echo(7, 0.0)

    def hear(
        self, body: Datagram, by: str = "r1", to: Author | None = None, now: float = 0.1
    ) -> Datagram | None:
        """What anna takes of a datagram that `by` signed, for all or for one asker."""
        payload = self.keyring.trust(by).signer.sign(pack(TAG, body), to)
        return self.answers.admit(body, payload, ROBOT, now)


@pytest.fixture
def rig(keyring: Keyring) -> Rig:
    return Rig(keyring)


def test_a_robot_counts_once_it_answered_and_then_by_rising_sequences(rig: Rig) -> None:
    assert rig.hear(BEACON) is None
    answer = replace(BEACON, sequence=11, echo=7)
    assert rig.hear(answer, to=ANNA) == answer
    later = replace(BEACON, sequence=12)
    assert rig.hear(later) == later
    assert rig.hear(later) is None
    assert rig.hear(replace(BEACON, sequence=13, flags=Flag.JOINING)) is None
    farewell = replace(BEACON, sequence=14, flags=Flag.LEFT)
    assert rig.hear(farewell) == farewell
    assert rig.hear(replace(BEACON, sequence=99), now=9.0) is None


def test_a_replayed_answer_to_another_question_counts_for_nothing(rig: Rig) -> None:
    assert rig.hear(replace(BEACON, echo=6), to=ANNA) is None
    assert rig.hear(replace(LIST, echo=6), to=ANNA) is None


def test_no_robot_answers_for_another_one(rig: Rig) -> None:
    answer = replace(BEACON, echo=7)
    assert rig.hear(answer, by="r2", to=ANNA) is None
    assert rig.hear(answer, by="r1", to=ANNA._replace(name="bob")) is None
    assert rig.hear(answer, by="r1") is None  # signed for all
    assert rig.hear(answer, to=ANNA) == answer
    assert rig.hear(LIST, by="r2", to=ANNA) is None


def test_lists_name_robots_of_the_roster_only(rig: Rig) -> None:
    assert rig.hear(LIST, to=ANNA) is None  # before its robot has answered
    rig.hear(replace(BEACON, echo=7), to=ANNA)
    word = rig.hear(LIST, to=ANNA)
    assert isinstance(word, MemberList)
    assert [one.robot for one in word.members] == ["r2"]
    assert word.roster == ("r2",)
    ghost = replace(BEACON, robot="ghost", echo=7)
    assert rig.hear(ghost, to=ANNA) is None


@pytest.mark.parametrize("via", ["", "r2"])
def test_acks_count_with_the_proof_of_their_robot_alone(via: str, rig: Rig) -> None:
    signer = rig.keyring.trust("r1").signer
    proven = replace(ACK, proof=signer.proof(ACK, "anna"), via=via)
    assert rig.hear(proven, by=via or "r1") == proven
    assert rig.hear(replace(ACK, via=via), by="r2") is None
    thief = replace(ACK, proof=rig.keyring.trust("r2").signer.proof(ACK, "anna"))
    assert rig.hear(thief, by="r2") is None


def test_an_answer_of_a_robot_without_a_key_counts_as_not_proven(keyring: Keyring) -> None:
    full = keyring.identity("anna")
    rig = Rig(keyring)
    keys = replace(full.datagram_keys, answers={})
    rig.answers = Answers(type(full)(full.folder, full.info, full.roster, keys), 3.0)
    rig.answers.liveness.note_echo(7, 0.0)
    assert rig.hear(replace(BEACON, echo=7), to=ANNA) is not None
    assert rig.hear(ACK) == ACK
    assert rig.answers.unproven == {"r1"}
    assert rig.answers.admit(ACK, pack(TAG, ACK), ROBOT, 0.1) is None


def test_other_generations_are_hints_and_acks_count_across_them(rig: Rig) -> None:
    proven = replace(ACK, proof=rig.keyring.trust("r1").signer.proof(ACK, "anna"))
    old = rig.keyring.trust("r1").signer.sign(pack(TAG, BEACON))
    rig.keyring.renew()
    assert rig.hear(replace(BEACON, echo=7), to=ANNA) is None
    assert rig.hear(BEACON, now=1.0) is None
    assert rig.hints == [("r1", ROBOT, rig.keyring.roster.generation)]
    assert rig.hear(proven) == proven
    newer = Rig(rig.keyring)
    assert newer.answers.admit(BEACON, old, ROBOT, 0.1) is None
    assert newer.answers.outdated == {"r1": ROBOT}
