"""What an operator takes from the robots of a secured swarm."""

from __future__ import annotations

import threading

import pytest
from msgspec.structs import replace

from swarmd.core.errors import ConfigError
from swarmd.link.datagram import (
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
from swarmd.link.keys.identity import Identity
from swarmd.link.keys.roster import Role
from swarmd.link.settings import NetworkSettings
from swarmd.link.signature import Author, Previous, Trust
from swarmd.operator.session import roster_update
from swarmd.operator.session.admission import OperatorAdmission
from swarmd.operator.session.roster import RosterFollower
from tests.link.keyring import Keyring

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
        self.answers = OperatorAdmission(
            keyring.identity("anna"), 3.0, lambda *hint: self.hints.append(hint)
        )
        self.answers.freshness.note_echo(7, 0.0)

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


def test_nothing_of_a_robot_counts_without_its_key(keyring: Keyring) -> None:
    """Any robot of the roster can make these in the name of a robot that was added later."""
    full = keyring.identity("anna")
    keys = replace(full.datagram_keys, answers={"r2": full.datagram_keys.answers["r2"]})
    lacking: list[tuple[str, Address]] = []
    rig = Rig(keyring)
    rig.answers = OperatorAdmission(
        replace(full, datagram_keys=keys),
        3.0,
        on_missing_key=lambda *hint: lacking.append(hint),
    )
    rig.answers.freshness.note_echo(7, 0.0)
    proven = replace(ACK, proof=keyring.trust("r1").signer.proof(ACK, "anna"))
    answer = replace(BEACON, echo=7)
    assert rig.hear(replace(proven, via="r2"), by="r2") is None
    assert rig.answers.admit(proven, pack(TAG, proven), ROBOT, 0.1) is None
    assert lacking == []  # where r1 is, no robot has shown yet
    for body in (answer, proven, ACK, LIST):
        for thief in ("r1", "r2"):
            assert rig.hear(body, by=thief, to=ANNA) is None
            assert rig.hear(body, by=thief) is None
    assert (lacking, rig.answers.unproven) == ([("r1", ROBOT)], {"r1": ROBOT})
    assert rig.hear(answer, to=ANNA, now=6.0) is None
    assert lacking == [("r1", ROBOT)] * 2
    rig.answers.take_keys(full)
    assert rig.answers.unproven == {}
    assert rig.hear(proven) == proven
    assert rig.hear(replace(proven, via="r2"), by="r2") is not None
    assert rig.hear(ACK) is None


class Following:
    """An operator that follows rosters, without a network."""

    settings = NetworkSettings()

    def __init__(self, identity: Identity) -> None:
        self.identity: Identity | None = identity

    def take_identity(self, identity: Identity) -> None:
        self.identity = identity


def test_a_robot_that_was_added_later_hides_no_robot_that_proves_a_newer_roster(
    keyring: Keyring, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A link proves the names of the own roster alone, so that only these can hand one over."""
    following = Following(keyring.identity("anna"))
    rosters, pulled = RosterFollower(following, is_on=True), list[str]()
    rig = Rig(keyring)
    rig.answers = OperatorAdmission(
        keyring.identity("anna"), 3.0, rosters.on_shown, rosters.on_missing_key
    )

    def pull(settings: object, identity: Identity, robot: str, *_: object) -> tuple[None, str]:
        pulled.append(robot)
        return None, "no answer"

    monkeypatch.setattr(roster_update, "pulled_roster", pull)
    keyring.renew(add=("r0", "r3"))
    late = replace(BEACON, robot="r0")
    for number in range(5):
        now = 10.0 * number
        rig.hear(late, by="r0", now=now)
        rosters.update()
        rig.hear(BEACON, now=now)
        rig.hear(replace(BEACON, robot="r3"), by="r3", now=now)
        rosters.update()
    assert pulled == ["r1"] * 5
    rig.hear(late, by="r0", now=100.0)
    assert rosters.shown == ("r0", ROBOT, keyring.roster.generation)  # for a note


def test_an_ack_needs_the_signature_of_its_datagram_beside_its_proof(
    keyring: Keyring, rig: Rig
) -> None:
    """A name that was revoked keeps the keys of its pairs, and not those of the generation."""
    thief = keyring.trust("r2").signer
    keyring.renew(remove=("r2",))
    for ack in (replace(ACK, robot="r2"), ACK):
        for answers in (rig.answers, Rig(keyring).answers):
            proven = replace(ack, proof=thief.proof(ack, "anna"))
            bare = pack(TAG, proven)
            assert answers.admit(proven, bare, ROBOT, 0.1) is None
            assert answers.admit(proven, bare + bytes(21), ROBOT, 0.1) is None
    newer = Rig(keyring)
    proven = replace(ACK, robot="r2", proof=thief.proof(replace(ACK, robot="r2"), "anna"))
    assert newer.answers.admit(proven, thief.sign(bare), ROBOT, 0.1) is None
    assert newer.hear(proven, by="r1") is None  # r2 is not on the roster any more


def test_other_generations_are_hints_and_those_before_get_answers_that_they_can_verify(
    rig: Rig,
) -> None:
    keyring = rig.keyring
    old = keyring.trust("r1").signer.sign(pack(TAG, BEACON))
    before = Previous(keyring.keys("r1"), keyring.roster, until=600.0)
    keyring.renew()
    assert rig.hear(replace(BEACON, echo=7), to=ANNA) is None
    assert rig.hear(BEACON, now=1.0) is None
    assert rig.hints == [("r1", ROBOT, keyring.roster.generation)]
    signer = Trust.of(keyring.identity("r1"), before).signer
    proven = replace(ACK, proof=signer.proof(ACK, "anna"))
    assert rig.hear(proven, to=ANNA) is None
    payload = signer.sign(pack(TAG, proven), ANNA._replace(is_previous=True))
    assert rig.answers.admit(proven, payload, ROBOT, 0.1) == proven
    newer = Rig(rig.keyring)
    assert newer.answers.admit(BEACON, old, ROBOT, 0.1) is None
    assert newer.answers.outdated == {"r1": ROBOT}


@pytest.mark.parametrize("error", [OSError(24, "Too many open files"), ConfigError("no key file")])
def test_keys_that_cannot_be_had_are_a_notice_and_no_fault_of_the_thread(
    keyring: Keyring, monkeypatch: pytest.MonkeyPatch, error: Exception
) -> None:
    def fail(*_: object) -> None:
        raise error

    rosters = RosterFollower(Following(keyring.identity("anna")), is_on=True)
    for name in ("pulled_keys", "pulled_roster"):
        monkeypatch.setattr(roster_update, name, fail)
    faults: list[object] = []
    monkeypatch.setattr(threading, "excepthook", faults.append)
    rosters.on_missing_key("r3", ROBOT)
    rosters.begin()
    assert rosters._updating is not None
    rosters._updating.join(60.0)
    assert (len(rosters.notices), faults) == (1, [])


@pytest.mark.parametrize("error", [OSError(24, "Too many open files"), ConfigError("no key file")])
def test_a_robot_whose_key_cannot_be_had_is_left_out(
    keyring: Keyring, monkeypatch: pytest.MonkeyPatch, error: Exception
) -> None:
    async def fail(*_: object, **__: object) -> bytes:
        raise error

    monkeypatch.setattr(roster_update, "pull", fail)
    identity = keyring.identity("anna")
    assert roster_update.pulled_keys(NetworkSettings(), identity, [("r3", ROBOT)]) is None
