"""Attacks on the datagrams of a secured swarm in virtual time."""

from __future__ import annotations

from typing import get_args

import pytest
from msgspec.structs import replace

from swarmd.core.kin_message import KinMessage
from swarmd.core.messages import Latch, Presence, State
from swarmd.core.values import Pose, SharedPose
from swarmd.link.datagram import (
    Ack,
    Address,
    Beacon,
    Datagram,
    Flag,
    KinReport,
    Latches,
    MemberList,
    MemberReport,
    Message,
    Place,
    Solicit,
    Stop,
    pack,
)
from swarmd.link.keys.roster import Role
from swarmd.link.members.admission import SIGNERS
from swarmd.link.signature import Flaw, Signer
from tests.link.keyring import Keyring
from tests.link.virtual_network import OPERATOR, TAG, Robot, VirtualNetwork

STRANGER: Address = ("10.0.0.66", 6666)
GHOST = Beacon(robot="r9", instance=b"ghosts", sequence=5, wire=1, state=1, revision=2)


@pytest.fixture
def keyring() -> Keyring:
    names = tuple(f"r{number}" for number in range(1, 10))
    return Keyring(names, operators=("anna", "bob"), viewers=("class",))


@pytest.fixture
def network(keyring: Keyring) -> VirtualNetwork:
    made = VirtualNetwork(3, keyring=keyring)
    made.until(lambda: all(len(alive(made, name)) == 2 for name in made.robots))
    made.is_tapped = True
    for robot in made.robots.values():
        robot.flaws.clear()
    return made


def alive(network: VirtualNetwork, name: str) -> set[str]:
    return {robot for robot, _ in network.robots[name].peer.membership.alive_addresses()}


def presence(network: VirtualNetwork, name: str, of: str) -> Presence | None:
    member = network.robots[name].peer.membership.member(of, network.now)
    return None if member is None else member.presence


def recorded(network: VirtualNetwork, kind: type[Datagram], sender: str) -> list[bytes]:
    return [raw for name, body, raw, _ in network.tapped if name == sender and type(body) is kind]


def state_of(robot: Robot) -> tuple[object, ...]:
    return robot.state, dict(robot.latches), list(robot.stops), list(robot.messages)


def test_every_kind_of_datagram_has_its_signers() -> None:
    """By the roles of docs/security.md: robots tell, operators command, each name may ask.

    A robot hands on the stops of operators. `Swarm` is never signed.
    """
    told = "Beacon MemberList Ack Latches Message Place KinReport ClockReply GoalReport"
    wanted = dict.fromkeys(told.split(), "robot")
    wanted |= dict.fromkeys(("Solicit", "ClockQuery"), "operator permit robot viewer")
    wanted |= {
        "Stop": "operator permit robot",
        "RunLease": "operator",
        "Swarm": "",
        "StatusPart": "",
        "Drive": "operator permit",
    }
    assert {kind.__name__: " ".join(sorted(roles)) for kind, roles in SIGNERS.items()} == wanted
    assert set(SIGNERS) == set(get_args(Datagram))


# A stranger


FORGED: dict[str, Datagram] = {
    "beacon": GHOST,
    "farewell": replace(GHOST, robot="r2", flags=Flag.LEFT, sequence=2**50),
    "own id": replace(GHOST, robot="r1"),
    "stop": Stop(id="s", verb="stop", operator="anna"),
    "estop": Stop(id="s", verb="estop", operator="anna", scope="swarm", hops=1),
    "latches": Latches(
        robot="r2",
        instance=b"ghosts",
        digest=b"123456",
        held={"l": Latch(issuer="anna", scope="swarm")},
    ),
    "kin": KinReport(robot="r2", instance=b"ghosts", message=KinMessage(7, 1000, 0, 0, 0)),
    "message": Message(robot="r2", instance=b"ghosts", sequence=1, channel="a/b", payload=b"x"),
    "ack": Ack(id="s", robot="r2", instance=b"ghosts", revision=1, code="applied"),
    "member list": MemberList(
        robot="r2",
        instance=b"ghosts",
        members=(MemberReport(robot="r8", instance=b"ghosts", presence=0, age=1),),
    ),
    "solicit": Solicit(echo=3, wants_members=True),
}


@pytest.mark.parametrize("name", FORGED)
def test_what_a_stranger_makes_is_dropped_and_counted(name: str, network: VirtualNetwork) -> None:
    trailers = (b"", bytes(29), b"\3" + bytes(3) + b"\2\4anna" + bytes(8))
    before = {robot: state_of(one) for robot, one in network.robots.items()}
    for trailer in trailers * 5:
        network.inject(pack(TAG, FORGED[name]) + trailer, STRANGER)
        network.run(0.05)
    assert {robot: state_of(one) for robot, one in network.robots.items()} == before
    for robot in network.robots.values():
        assert sum(robot.flaws.values()) == 15
        assert not robot.duplicates
    assert not network.unicast[STRANGER]
    assert alive(network, "r1") == {"r2", "r3"}


def test_a_peer_of_a_secured_swarm_takes_nothing_without_an_author(network: VirtualNetwork) -> None:
    robot = network.robots["r1"]
    effects = robot.peer.on_datagram(FORGED["stop"], STRANGER, network.now, robot.summary)
    assert (effects.flaw, effects.stops) == (Flaw.UNSIGNED, [])


def test_thousands_of_false_names_take_no_place(network: VirtualNetwork) -> None:
    for number in range(2000):
        network.inject(pack(TAG, replace(GHOST, robot=f"ghost-{number}")), STRANGER, "r1")
    network.run(1.0)
    peer = network.robots["r1"].peer
    assert set(peer.membership.members(network.now)) == {"r2", "r3"}
    assert network.robots["r1"].flaws[Flaw.UNSIGNED] == 2000


# Replays


def test_replayed_beacons_do_not_show_a_robot_alive_that_is_gone(network: VirtualNetwork) -> None:
    network.run(5.0)
    network.robots["r3"].is_up = False
    network.until(lambda: presence(network, "r1", "r3") is Presence.FAILED)
    for raw in recorded(network, Beacon, "r3") * 3:
        network.inject(raw, STRANGER)
        network.run(0.2)
        assert presence(network, "r1", "r3") is Presence.FAILED
    assert network.robots["r1"].flaws[Flaw.UNPROVEN] > 3
    # It is asked, at most as often as a question to it is due.
    assert 3 < len(recorded(network, Solicit, "r1")) < 40
    network.robots["r3"].is_up = True
    network.until(lambda: presence(network, "r1", "r3") is Presence.ALIVE, cap=2.0)


def test_a_replayed_answer_does_not_lengthen_a_life(network: VirtualNetwork) -> None:
    network.run(1.0)
    network.inject(pack(TAG, Solicit(echo=1)), STRANGER)
    network.robots["r2"].is_up = False  # silent, so that r1 asks
    network.run(2.0)
    network.robots["r2"].is_up = True
    network.run(1.0)
    network.robots["r2"].is_up = False
    went = network.now
    answers = recorded(network, Beacon, "r2")
    while network.now < went + 15.0:
        for raw in answers:
            network.inject(raw, STRANGER, "r1")
        network.run(0.25)
    assert presence(network, "r1", "r2") is Presence.FAILED
    member = network.robots["r1"].peer.membership.member("r2", network.now)
    assert member is not None
    assert member.age > 10.0


def test_replays_of_many_earlier_lives_keep_no_robot_from_joining(
    keyring: Keyring, network: VirtualNetwork
) -> None:
    r2 = keyring.trust("r2").signer
    lives = [
        r2.sign(pack(TAG, replace(GHOST, robot="r2", instance=number.to_bytes(6, "little"))))
        for number in range(1, 200)
    ]

    def replay() -> None:
        for raw in lives:
            network.inject(raw, STRANGER, "r1")
        network.run(0.1)

    for _ in range(100):
        replay()
    network.add("r4")
    began = network.now
    while "r4" not in alive(network, "r1"):
        replay()
        assert network.now - began < 6.0
    assert alive(network, "r1") == {"r2", "r3", "r4"}


def test_a_replayed_farewell_makes_no_robot_leave(network: VirtualNetwork) -> None:
    robot = network.robots["r3"]
    network._send("r3", robot.address, robot.peer.leave_beacon(robot.summary), None)
    robot.is_up = False
    network.run(0.1)
    assert presence(network, "r1", "r3") is Presence.LEFT
    (farewell,) = [raw for _, body, raw, _ in network.tapped if _is_farewell(body)]
    network.add("r3")
    network.until(lambda: presence(network, "r1", "r3") is Presence.ALIVE, cap=5.0)
    for _ in range(10):
        network.inject(farewell, robot.address)
        network.run(0.3)
        assert presence(network, "r1", "r3") is Presence.ALIVE


def _is_farewell(body: Datagram) -> bool:
    return isinstance(body, Beacon) and bool(body.flags & Flag.LEFT)


def test_replays_of_an_earlier_life_fault_no_robot_and_keep_none_from_its_id(
    network: VirtualNetwork,
) -> None:
    network.run(3.0)
    network.robots["r3"].is_up = False
    network.run(1.0)
    old = recorded(network, Beacon, "r3")
    assert old
    again = network.add("r3")
    began = network.now
    while not again.peer.owns_id:
        for raw in old:
            network.inject(raw, STRANGER, "r3")
        network.run(0.05)
        assert again.peer.holder is None
        assert network.now - began < 3.0
    for raw in old * 5:
        network.inject(raw, STRANGER, "r3")
        network.run(0.2)
    assert not again.duplicates
    assert not again.peer.duplicates


def test_two_owners_of_an_id_still_notice_each_other(keyring: Keyring) -> None:
    network = VirtualNetwork(0, keyring=keyring)
    network.reaches = lambda sender, receiver: False
    first, second = network.add("r1", "one"), network.add("r1", "two")
    network.run(3.0)
    network.reaches = lambda sender, receiver: True
    network.until(lambda: bool(first.peer.duplicates and second.peer.duplicates), cap=2.0)
    second.is_up = False
    network.until(lambda: not first.peer.duplicates, cap=5.0)


def test_replayed_latches_are_not_taken_over(network: VirtualNetwork) -> None:
    r1 = network.robots["r1"]
    r1.state, r1.latches["e1"] = State.ESTOPPED, Latch(issuer="anna", scope="swarm")
    network.until(lambda: all(robot.latches for robot in network.robots.values()), cap=1.0)
    network.run(2.0)  # no copy is on its way
    taken = recorded(network, Latches, "r1") + recorded(network, Beacon, "r1")
    for robot in network.robots.values():
        robot.latches.clear()
        robot.state = State.IDLE
    network.run(5.0)
    for raw in taken * 3:
        network.inject(raw, r1.address)
        network.run(0.1)
    assert not any(robot.latches for robot in network.robots.values())


def test_replayed_messages_and_places_are_not_taken(network: VirtualNetwork) -> None:
    pose = SharedPose(0.0, Pose(1.0, 2.0, 0.5), error=0.05, yaw_error=0.1, frame="mocap")
    r2 = network.robots["r2"]
    for number in range(20):
        network._send("r2", r2.address, r2.peer.message("vote/a", bytes([number])), None)
        place = r2.peer.place(pose, 0.1, network.now)
        if place is not None:
            network._send("r2", r2.address, place, None)
        network.run(0.1)
    assert len(network.robots["r1"].messages) == 20
    assert len(network.robots["r1"].places) > 10
    old = recorded(network, Message, "r2") + recorded(network, Place, "r2")
    late = network.add("r4")  # it has not heard them
    network.until(lambda: alive(network, "r4") == {"r1", "r2", "r3"}, cap=5.0)
    network.run(2.0)
    for raw in old:
        network.inject(raw, r2.address, "r4")
        network.inject(raw, r2.address, "r1")
        network.run(0.1)
    assert (late.messages, late.places) == ([], [])
    assert len(network.robots["r1"].messages) == 20
    network._send("r2", r2.address, r2.peer.message("vote/a", b"new"), None)
    network.run(0.1)
    assert late.messages == [b"new"]


def test_replayed_kin_reports_are_not_taken(network: VirtualNetwork) -> None:
    r1, r2 = network.robots["r1"], network.robots["r2"]
    for number in range(5):
        told = KinMessage(7, round(1000.0 * network.now), number, 0, 0)
        report = r2.peer.kin_report(told)
        assert report is not None
        network._send("r2", r2.address, report, None)
        network.run(0.2)
    assert [report.message.x for report in r1.kin] == [0, 1, 2, 3, 4]
    for raw in recorded(network, KinReport, "r2"):
        network.inject(raw, r2.address, "r1")
        network.run(0.1)
    assert len(r1.kin) == 5


def test_a_place_between_two_kin_reports_is_no_replay(network: VirtualNetwork) -> None:
    """Both have times of one clock; a report is of the last scan, before the place."""
    r1, r2 = network.robots["r1"], network.robots["r2"]
    pose = SharedPose(0.0, Pose(1.0, 2.0, 0.5), error=0.05, yaw_error=0.1, frame="mocap")
    for _ in range(20):
        report = r2.peer.kin_report(KinMessage(7, round(1000.0 * network.now) - 50, 0, 0, 0))
        for sent in (r2.peer.place(pose, 0.1, network.now), report):
            assert sent is not None
            network._send("r2", r2.address, sent, None)
        network.run(0.2)
    assert Flaw.REPEATED not in r1.flaws
    assert len(r1.kin) == 20
    assert len(r1.places) > 10  # once the delay is known


def test_replayed_member_lists_name_no_robot(network: VirtualNetwork) -> None:
    network.solicit()
    network.run(15.0)
    old = recorded(network, MemberList, "r2")
    assert old
    network.robots["r3"].is_up = False
    network.run(20.0)
    network.robots["r1"].peer.membership.forget("r3")
    for raw in old:
        network.inject(raw, network.robots["r2"].address, "r1")
    network.run(0.1)
    assert not network.robots["r1"].peer.membership.knows("r3")


def test_a_replayed_stop_is_known_and_grows_old(network: VirtualNetwork) -> None:
    network.send(Stop(id="s1", verb="stop", operator="anna", origin=b"home", counter=1000))
    network.run(0.2)
    (raw,) = recorded(network, Stop, "operator")
    network.run(100.0)
    network.ages.clear()
    network.inject(raw, OPERATOR)
    network.run(0.1)
    assert min(network.ages["s1"]) > 99_000
    network.send(Stop(id="s2", verb="stop", operator="anna", origin=b"home", counter=2_000_000))
    network.run(0.2)
    network.run(70.0)  # beyond the life of any relay
    fresh = network.add("r4")
    network.until(lambda: fresh.peer.owns_id, cap=3.0)
    network.send(Stop(id="s3", verb="stop", operator="anna", origin=b"home", counter=3_000_000))
    network.run(70.0)
    network.inject(raw, OPERATOR, "r4")
    network.run(0.1)
    assert fresh.replayed == ["s1"]
    assert "s1" not in fresh.stops


# Stolen keys


def signer(keyring: Keyring, name: str, role: Role, as_name: str = "") -> Signer:
    return Signer(keyring.keys(name), role, as_name or name)


@pytest.mark.parametrize("verb", ["stop", "estop"])
def test_a_viewer_asks_and_does_nothing_else(
    verb: str, keyring: Keyring, network: VirtualNetwork
) -> None:
    viewer = signer(keyring, "class", Role.VIEWER)
    stop = replace(Stop(id="s", verb="stop", operator="class"), verb=verb)
    for body in (stop, replace(stop, operator="anna"), GHOST, replace(stop, hops=1)):
        network.inject(viewer.sign(pack(TAG, body)), STRANGER)
    network.inject(signer(keyring, "class", Role.OPERATOR, "anna").sign(pack(TAG, stop)), STRANGER)
    network.inject(signer(keyring, "class", Role.ROBOT).sign(pack(TAG, GHOST)), STRANGER)
    network.run(0.5)
    r1 = network.robots["r1"]
    assert not r1.stops
    assert (r1.flaws[Flaw.ROLE], r1.flaws[Flaw.FORGED]) == (4, 2)
    network.inject(viewer.sign(pack(TAG, Solicit(echo=77, wants_members=True))), STRANGER, "r1")
    network.run(0.1)
    answers = [body for name, body, _, _ in network.tapped if name == "r1"]
    assert any(isinstance(one, Beacon) and one.echo == 77 for one in answers)
    assert any(isinstance(one, MemberList) and one.echo == 77 for one in answers)


@pytest.mark.parametrize("name", ["bob", "bob by mcp"])
def test_an_operator_stops_in_its_own_name_only_and_is_no_robot(
    keyring: Keyring, network: VirtualNetwork, name: str
) -> None:
    bob = signer(keyring, "bob", Role.OPERATOR)
    stop = Stop(id="s", verb="stop", operator=name.replace("bob", "anna"))
    network.inject(bob.sign(pack(TAG, stop)), STRANGER)
    network.inject(bob.sign(pack(TAG, replace(stop, operator="bob", hops=1))), STRANGER)
    network.inject(bob.sign(pack(TAG, GHOST)), STRANGER)
    network.inject(signer(keyring, "bob", Role.ROBOT).sign(pack(TAG, GHOST)), STRANGER)
    network.run(0.2)
    r1 = network.robots["r1"]
    assert (r1.flaws[Flaw.FORGED], r1.flaws[Flaw.ROLE], r1.stops) == (3, 1, [])
    network.inject(bob.sign(pack(TAG, replace(stop, operator=name))), STRANGER)
    network.run(0.2)
    assert r1.stops


def test_a_stolen_robot_stops_in_the_name_of_others_and_acks_for_itself_alone(
    keyring: Keyring, network: VirtualNetwork
) -> None:
    thief = signer(keyring, "r3", Role.ROBOT)
    stop = Stop(id="s", verb="stop", operator="anna", hops=1)
    network.inject(thief.sign(pack(TAG, stop)), STRANGER, "r1")
    network.run(0.1)
    assert network.robots["r1"].stops == ["s"]
    direct = replace(stop, id="t", hops=0)  # as if it were the operator
    network.inject(thief.sign(pack(TAG, direct)), STRANGER, "r1")
    network.run(0.1)
    assert network.robots["r1"].flaws[Flaw.FORGED] == 1
    anna = keyring.trust("anna").verifier
    ack = Ack(id="s", robot="r1", instance=b"123456", revision=1, code="applied")
    assert anna.is_proven(replace(ack, proof=thief.proof(ack, "anna"))) is False
    # Names that are not on the roster stay out, and so do those on its lists.
    network.inject(thief.sign(pack(TAG, replace(GHOST, robot="ghost"))), STRANGER)
    network.run(0.1)
    assert network.robots["r1"].flaws[Flaw.FORGED] == 2


def test_a_stolen_robot_poses_toward_robots_as_another_one_and_as_an_operator(
    keyring: Keyring, network: VirtualNetwork
) -> None:
    """What the docs say that it can do; see the tests of answers for operators."""
    thief = signer(keyring, "r3", Role.ROBOT)
    network.inject(thief.sign(pack(TAG, GHOST)), STRANGER, "r1")
    network.run(0.1)
    (echo,) = [
        body.echo
        for _, body, _, _ in network.tapped
        if isinstance(body, Solicit) and body.robot == "r9"
    ]
    answer = replace(GHOST, sequence=6, echo=echo)
    network.inject(thief.sign(pack(TAG, answer)), STRANGER, "r1")
    vote = Message(robot="r9", instance=b"ghosts", sequence=1, channel="a/b", payload=b"vote")
    network.run(0.1)
    network.inject(thief.sign(pack(TAG, vote)), STRANGER, "r1")
    network.run(0.1)
    assert "r9" in alive(network, "r1")
    assert network.robots["r1"].messages == [b"vote"]
    own = replace(keyring.keys("r3"), own=keyring.keys("r3").of_name("anna"))
    stop = Stop(id="s", verb="stop", operator="anna")
    network.inject(Signer(own, Role.OPERATOR, "anna").sign(pack(TAG, stop)), STRANGER, "r1")
    network.run(0.1)
    assert network.robots["r1"].stops == ["s"]


def test_replayed_questions_are_answered_within_the_limits(network: VirtualNetwork) -> None:
    network.solicit()
    network.run(0.1)
    (raw,) = recorded(network, Solicit, "operator")
    for _ in range(200):
        network.inject(raw, STRANGER, "r1")
    network.run(0.1)
    assert 0 < network.unicast[STRANGER] <= 30


def test_another_operator_of_a_removed_generation_stops_for_ten_minutes_and_asks_nothing(
    keyring: Keyring, network: VirtualNetwork
) -> None:
    bob = signer(keyring, "bob", Role.OPERATOR)
    network.change_roster(remove=("bob",))
    network.tapped.clear()
    network.inject(bob.sign(pack(TAG, Solicit(echo=9))), STRANGER)
    network.inject(bob.sign(pack(TAG, Stop(id="s", verb="stop", operator="bob"))), STRANGER)
    network.run(0.2)
    assert network.robots["r1"].stops
    assert network.robots["r1"].flaws[Flaw.OLDER] == 1
    network.run(600.0)
    network.inject(bob.sign(pack(TAG, Stop(id="t", verb="estop", operator="bob"))), STRANGER)
    network.run(0.2)
    assert "t" not in network.robots["r1"].stops


# Without an attack


@pytest.mark.long
def test_fifty_robots_meet_with_few_questions(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("swarmd.link.peer.CLAIM_PERIOD", 0.5)  # claims are not the matter here
    count = 50
    names = tuple(f"r{number}" for number in range(1, count + 1))
    network = VirtualNetwork(count, keyring=Keyring(names, operators=("anna",)), joined=False)
    full = lambda: all(len(alive(network, name)) == count - 1 for name in network.robots)  # noqa: E731
    assert network.until(full, cap=15.0) < 15.0
    assert network.sent_kinds[Solicit] <= count * (count - 1) + 10 * count
    network.send(Stop(id="s", verb="stop", operator="anna"))
    network.run(2.0)
    assert len(network.acks()) == count
