"""Peers in virtual time: membership, claims, latches, relayed stops and lost messages."""

from __future__ import annotations

import math
from typing import Literal

import pytest
from msgspec.structs import replace

from swarmd.core.goal import Goal
from swarmd.core.kin_message import KinMessage
from swarmd.core.messages import Latch, Presence, State
from swarmd.core.values import Pose, SharedPose
from swarmd.link.datagram import (
    Ack,
    Beacon,
    ClockQuery,
    ClockReply,
    MemberList,
    Solicit,
    Stop,
)
from swarmd.link.members.beacon_times import BEACON_PERIOD
from swarmd.link.members.peer_places import FASTEST_DATAGRAM
from tests.link.keyring import Keyring
from tests.link.virtual_network import OPERATOR, VirtualNetwork

KEYRING = Keyring(tuple(f"r{number}" for number in range(1, 9)), operators=("anna",))
with_and_without_keys = pytest.mark.parametrize("keyring", [None, KEYRING], ids=["plain", "keys"])


def presences(network: VirtualNetwork, name: str) -> dict[str, Presence]:
    members = network.robots[name].peer.membership.members(network.now)
    return {robot: member.presence for robot, member in members.items()}


def all_know_each_other(network: VirtualNetwork) -> bool:
    names = set(network.robots)
    return all(
        {other for other, is_in in presences(network, name).items() if is_in is Presence.ALIVE}
        == names - {name}
        for name in names
    )


# Membership


@with_and_without_keys
@pytest.mark.parametrize(("delay", "loss"), [(0.005, 0.0), (0.25, 0.0), (0.5, 0.2), (0.01, 0.2)])
def test_all_robots_know_each_other_on_any_link(
    delay: float, loss: float, keyring: Keyring | None
) -> None:
    network = VirtualNetwork(8, joined=False, keyring=keyring)
    network.delay, network.loss = delay, loss
    assert network.until(lambda: all_know_each_other(network), cap=15.0) < 15.0


@pytest.mark.long
def test_an_idle_robot_sends_one_datagram_a_second_and_few_for_words() -> None:
    network = VirtualNetwork(20)
    network.sent.clear()
    network.run(60.0)
    beacons = 60.0 / BEACON_PERIOD
    for name in network.robots:
        # A question for words every 10 s, and two datagrams to answer one.
        assert beacons - 2 <= network.sent[name] <= beacons + 6 * 1.5 * 3


@pytest.mark.parametrize(
    ("keyring", "seconds"), [(None, 300.0), (KEYRING, 100.0)], ids=["plain", "keys"]
)
def test_loss_of_a_fifth_of_all_datagrams_fails_nobody(
    keyring: Keyring | None, seconds: float
) -> None:
    network = VirtualNetwork(6, keyring=keyring)
    network.until(lambda: all_know_each_other(network))
    network.loss = 0.2
    for robot in network.robots.values():
        robot.changes.clear()
    network.run(seconds)
    changes = sum(len(robot.changes) for robot in network.robots.values())
    assert changes <= 2, "30 directed pairs for 5 minutes"


def test_a_robot_that_vanishes_fails_after_its_lease_and_returns() -> None:
    network = VirtualNetwork(3)
    network.robots["r3"].is_up = False
    network.run(1.8)  # its last beacon may have been up to 1 s old
    assert presences(network, "r1")["r3"] is Presence.ALIVE
    network.until(lambda: presences(network, "r1")["r3"] is Presence.FAILED, cap=1.3)
    network.robots["r3"].is_up = True
    network.until(lambda: presences(network, "r1")["r3"] is Presence.ALIVE, cap=1.5)


def test_a_robot_that_leaves_is_listed_as_left() -> None:
    network = VirtualNetwork(3)
    robot = network.robots["r3"]
    network._send("r3", robot.address, robot.peer.leave_beacon(robot.summary), None)
    robot.is_up = False
    network.run(0.1)
    assert presences(network, "r1")["r3"] is Presence.LEFT
    network.run(10.0)
    assert presences(network, "r1")["r3"] is Presence.LEFT


def test_a_robot_that_restarts_is_no_duplicate_of_itself() -> None:
    network = VirtualNetwork(2)
    network.robots["r2"].is_up = False
    network.run(0.3)
    network.add("r2")
    network.until(lambda: network.robots["r2"].peer.owns_id, cap=3.0)
    network.run(0.2)
    peer = network.robots["r1"].peer
    assert peer.membership.duplicates(network.now) == {}
    assert peer.membership.members(network.now)["r2"].instance == (3).to_bytes(6, "big").hex()


def test_robots_beyond_reach_are_known_by_the_word_of_those_between() -> None:
    network = VirtualNetwork(3)
    line = {("r1", "r2"), ("r2", "r1"), ("r2", "r3"), ("r3", "r2"), ("operator", "r1"),
            ("r1", "operator")}  # fmt: skip
    network.robots.clear()
    network.reaches = lambda sender, receiver: (sender, receiver) in line
    for name in ("r1", "r2", "r3"):
        network.add(name)
    network.run(30.0)
    network.solicit()
    network.run(0.2)
    words = [body for _, body in network.heard if isinstance(body, MemberList)]
    told = {heard.robot: heard for word in words for heard in word.members}
    assert {name: heard.hops for name, heard in told.items()} == {"r2": 0, "r3": 1}
    assert told["r3"].age <= 20_000
    assert set(presences(network, "r1")) == {"r2"}


# Claims


def test_second_owner_of_an_id_is_refused_and_sees_the_first() -> None:
    network = VirtualNetwork(1)
    second = network.add("r1", "other")
    network.until(lambda: second.peer.holder is not None, cap=1.0)
    assert second.peer.holder == (1).to_bytes(6, "big").hex()
    assert not second.peer.owns_id


def test_of_claimers_at_one_moment_exactly_one_wins() -> None:
    network = VirtualNetwork(0)
    robots = [network.add("r1", f"life{number}") for number in range(4)]
    network.run(5.0)
    assert [robot.peer.owns_id for robot in robots] == [True, False, False, False]


def test_two_owners_that_meet_when_a_cut_heals_both_notice() -> None:
    network = VirtualNetwork(0)
    network.reaches = lambda sender, receiver: False
    first, second = network.add("r1", "one"), network.add("r1", "two")
    network.run(3.0)
    assert first.peer.owns_id
    assert second.peer.owns_id
    network.reaches = lambda sender, receiver: True
    network.until(lambda: bool(first.peer.duplicates and second.peer.duplicates), cap=2.0)
    second.is_up = False
    network.until(lambda: not first.peer.duplicates, cap=5.0)


# Latches


def test_a_latch_reaches_those_that_were_cut_off_and_those_that_join() -> None:
    network = VirtualNetwork(6)
    near = {"r1", "r2", "r3", "operator"}
    network.reaches = lambda sender, receiver: (sender in near) == (receiver in near)
    network.stop("estop", 0.5)
    assert {name for name, robot in network.robots.items() if robot.latches} == near - {"operator"}
    network.run(90.0)  # beyond the life of any relay
    network.reaches = lambda sender, receiver: True
    network.add("r7")
    network.until(lambda: all(robot.latches for robot in network.robots.values()), cap=5.0)


def test_many_latches_are_taken_over_by_a_robot_that_joins() -> None:
    network = VirtualNetwork(2)
    held = {
        f"latch-{number}": Latch(issuer="x" * 128, scope="swarm", reason="y" * 256)
        for number in range(32)
    }
    network.robots["r1"].latches = dict(held)
    network.until(lambda: network.robots["r2"].latches.keys() == held.keys(), cap=5.0)
    network.add("r3")
    network.until(lambda: network.robots["r3"].latches.keys() == held.keys(), cap=5.0)


def test_a_robot_that_reset_its_latches_asks_its_peers_once_and_is_silent() -> None:
    network = VirtualNetwork(2)
    network.robots["r1"].latches["old"] = Latch(issuer="anna", scope="swarm")
    network.until(lambda: bool(network.robots["r2"].latches), cap=5.0)
    network.run(5.0)
    network.robots["r2"].latches.clear()
    network._carry_out = lambda *_: None  # type: ignore[method-assign]
    peer, robot = network.robots["r2"].peer, network.robots["r1"]
    beacon = robot.peer._beacon(robot.summary)
    for second in range(5):
        effects = peer.on_datagram(
            beacon, robot.address, network.now + second, network.robots["r2"].summary
        )
        asked = [body for body, _ in effects.sends if isinstance(body, Solicit)]
        assert not any(body.wants_latches for body in asked)


# Stops


@pytest.mark.parametrize("loss", [0.0, 0.2])
@pytest.mark.parametrize("delay", [0.005, 0.25, 0.5])
def test_every_robot_acks_a_stop_on_any_link(delay: float, loss: float) -> None:
    network = VirtualNetwork(6)
    network.delay, network.loss = delay, loss
    network.stop("stop", 4.0)
    network.run(1.5)
    assert network.acks().keys() == network.robots.keys()


@pytest.mark.long
def test_fifty_robots_that_all_hear_the_operator_say_little() -> None:
    network = VirtualNetwork(50)
    network.sent_kinds.clear()
    network.send(Stop(id="s", verb="stop", operator="anna"))
    network.run(5.0)
    assert len(network.acks()) == 50
    assert network.sent_kinds[Ack] <= 55
    assert 1 < network.sent_kinds[Stop] <= 30


@with_and_without_keys
@pytest.mark.parametrize("targets", [None, ("r3",)])
@pytest.mark.parametrize("verb", ["stop", "estop"])
def test_robots_pass_a_stop_on_and_the_ack_back(
    verb: Literal["stop", "estop"], targets: tuple[str] | None, keyring: Keyring | None
) -> None:
    network = VirtualNetwork(3, keyring=keyring)
    reach = {"operator": {"r1"}, "r1": {"operator", "r2"}, "r2": {"r1", "r3"}, "r3": {"r2"}}
    network.reaches = lambda sender, receiver: receiver in reach[sender]
    network.stop(verb, 3.0, targets)
    wanted = {"r3"} if targets else {"r1", "r2", "r3"}
    assert {name for name, robot in network.robots.items() if robot.stops} == wanted
    assert network.acks().keys() == wanted
    assert network.acks()["r3"].via == "r1"
    if keyring is not None:
        anna = keyring.trust("anna").verifier
        assert all(anna.is_proven(ack) for ack in network.acks().values())


def test_a_named_stop_arrives_after_a_cut_of_half_a_minute_without_its_operator() -> None:
    network = VirtualNetwork(2)
    network.reaches = lambda sender, receiver: "r2" not in (sender, receiver)
    network.stop("stop", 0.5, ("r2",))
    network.run(30.0)
    assert not network.robots["r2"].stops
    network.reaches = lambda sender, receiver: "operator" not in (sender, receiver)
    network.until(lambda: bool(network.robots["r2"].stops), cap=10.0)


def test_a_stop_is_passed_on_for_a_minute_and_no_longer() -> None:
    network = VirtualNetwork(2)
    network.reaches = lambda sender, receiver: "r2" not in (sender, receiver)
    network.stop("stop", 0.2, ("r2",))
    network.run(70.0)
    network.reaches = lambda sender, receiver: True
    network.run(30.0)
    assert not network.robots["r2"].stops


def relayed(network: VirtualNetwork, name: str, seconds: float) -> int:
    """How many stops a robot hands on in this time."""
    network.is_tapped = True
    network.tapped.clear()
    network.run(seconds)
    network.is_tapped = False
    return sum(sender == name and isinstance(body, Stop) for sender, body, _, _ in network.tapped)


@pytest.mark.parametrize("why", ["none", "run", "reset", "goal", "older goal", "goal of others"])
@pytest.mark.parametrize("targets", [None, ("r1",), ("r9",), ("r1", "r9")])
def test_a_stop_is_not_handed_on_after_a_newer_run_goal_or_reset(
    why: str, targets: tuple[str, ...] | None
) -> None:
    network = VirtualNetwork(1)
    robot = network.robots["r1"]
    goal = Goal(generation=1, issuer="bob", id="g", pattern="drive")
    if why == "older goal":
        robot.find(goal, 5.0, network.now)
    network.stop("stop", 0.2, targets)
    network.run(0.5)
    if why == "run":
        robot.wished = network.now
    elif why == "reset":
        robot.reset_at = network.now
    elif why == "goal":
        robot.find(goal, 0.0, network.now)
    elif why == "goal of others":
        robot.find(replace(goal, targets=("r2",)), 0.0, network.now)
    is_over = why == "goal" or (why == "run" and targets != ("r9",))
    is_over |= why == "reset" and targets is None
    is_silent = targets == ("r1",)  # no other robot is to stop
    assert (relayed(network, "r1", 10.0) == 0) is (is_over or is_silent)


@pytest.mark.parametrize("is_held", [False, True])
def test_an_estop_is_not_handed_on_after_its_reset(is_held: bool) -> None:
    network = VirtualNetwork(1)
    network.stop("estop", 0.2)
    robot = network.robots["r1"]
    robot.cleared = ("estop-id",)
    if not is_held:  # else it was issued again after the reset
        robot.latches.clear()
    assert (relayed(network, "r1", 10.0) == 0) is not is_held


def test_a_stop_that_waited_in_a_socket_is_as_old_as_its_wait() -> None:
    network = VirtualNetwork(1)
    robot = network.robots["r1"]
    stop = Stop(id="s", verb="stop", operator="anna", age=500, repeated=500)
    effects = robot.peer.on_datagram(stop, OPERATOR, network.now, robot.summary, waited=20.0)
    assert [one.age for one, _ in effects.stops] == [20500]
    network.is_tapped = True
    network.run(2.0)
    ages = [body.age for _, body, _, _ in network.tapped if isinstance(body, Stop)]
    assert ages
    assert min(ages) >= 20500
    assert all(body.repeated == 500 for _, body, _, _ in network.tapped if isinstance(body, Stop))


# Goals that a robot may join


JOINED = Goal(generation=4, issuer="bob", id="g4", pattern="drive", on_join="run", valid=600.0)
STAND = Goal(generation=5, issuer="bob", id="s")


@pytest.mark.parametrize("seed", range(5))
def test_a_robot_that_starts_joins_no_goal_that_others_know_has_ended(seed: int) -> None:
    network = VirtualNetwork(4, seed=seed)
    network.reaches = lambda sender, receiver: "late" in (sender, receiver)
    for name, robot in network.robots.items():
        robot.find(JOINED, 5.0, network.now)
        if name != "r1":
            robot.find(STAND, 1.0, network.now)
    late = network.add("late")
    late.find(JOINED, None, network.now)  # it ran it in its earlier life
    network.run(6.0)
    assert late.goals.held is not None
    assert late.goals.held.goal == STAND
    assert JOINED not in late.joinable


@pytest.mark.parametrize("loss", [0.0, 0.2])
def test_a_robot_that_starts_may_join_the_goal_of_all(loss: float) -> None:
    network = VirtualNetwork(4)
    network.run(3.0)
    for robot in network.robots.values():
        robot.find(JOINED, 5.0, network.now)
    network.loss = loss
    late = network.add("late")
    network.until(lambda: JOINED in late.joinable, 10.0)
    assert late.goals.held is not None
    assert late.goals.held.issued is not None


def test_a_robot_that_hears_of_a_greater_goal_joins_none_before_it_knows_that() -> None:
    network = VirtualNetwork(3)
    network.run(3.0)
    one, other, idle = network.robots.values()
    network.reaches = lambda sender, receiver: not (sender == "r3" and receiver == "r2")
    one.find(JOINED, 5.0, network.now)
    other.find(STAND, 1.0, network.now)
    network.reaches = lambda sender, receiver: (
        {sender, receiver} != {"r1", "r2"}
        and (
            (sender, receiver) != ("r3", "r2")  # r2 is heard, and does not hear the question
        )
    )
    network.run(10.0)
    assert idle.goals.held is not None
    assert idle.goals.held.goal == JOINED
    assert idle.joinable == []
    network.reaches = lambda sender, receiver: True
    network.until(lambda: STAND in idle.joinable, 5.0)


def test_a_greater_goal_among_robots_that_know_each_other_is_joined_at_once() -> None:
    network = VirtualNetwork(4)
    network.run(3.0)
    network.robots["r1"].find(JOINED, 0.0, network.now)
    others = [network.robots[name] for name in ("r2", "r3", "r4")]
    assert network.until(lambda: all(JOINED in one.joinable for one in others), 5.0) < 1.5


# Messages


def test_lost_messages_are_counted_and_copies_are_dropped() -> None:
    network = VirtualNetwork(2)
    sender, receiver = network.robots["r1"], network.robots["r2"]
    sent = [sender.peer.message("vote/choice", bytes([number])) for number in range(6)]
    order = [0, 1, 1, 3, 2, 5, 0]
    lost = 0
    for index in order:
        effects = receiver.peer.on_datagram(
            sent[index], sender.address, network.now, receiver.summary
        )
        lost += effects.lost
        receiver.messages.extend(message.payload for message in effects.messages)
    assert [payload[0] for payload in receiver.messages] == [0, 1, 3, 2, 5]
    assert lost == 1


@pytest.mark.parametrize("jump", [64, 1000, 2**53 - 1])
def test_a_jump_of_the_numbers_costs_nothing_and_counts_a_bounded_loss(jump: int) -> None:
    network = VirtualNetwork(2)
    sender, receiver = network.robots["r1"], network.robots["r2"]
    first = sender.peer.message("vote/choice", b"a")
    later = replace(first, sequence=jump + 1)
    for message, lost in ((first, 0), (later, 64), (replace(later, sequence=jump), 0)):
        effects = receiver.peer.on_datagram(message, sender.address, network.now, receiver.summary)
        assert effects.lost in (lost, -1)


@pytest.mark.parametrize(
    ("seed", "loss", "keyring"),
    [*((seed, 0.2, None) for seed in range(10)), pytest.param(1, 0.0, KEYRING, id="keys")],
)
def test_a_joining_robot_has_the_latches_of_the_others_before_it_is_settled(
    seed: int, loss: float, keyring: Keyring | None
) -> None:
    network = VirtualNetwork(3, seed=seed, keyring=keyring)
    network.robots["r2"].latches["e2"] = Latch(issuer="anna", scope="swarm")
    network.run(3.0)
    network.loss, network.delay = loss, 0.02
    robot = network.add("r4")
    network.until(lambda: robot.peer.owns_id, cap=10.0)
    network.until(lambda: robot.peer.is_in_sync(network.now), cap=1.0)
    assert "e2" in robot.latches


def test_a_stop_that_its_operator_repeats_for_minutes_is_still_passed_on() -> None:
    network = VirtualNetwork(2)
    network.reaches = lambda sender, receiver: "r2" not in (sender, receiver)
    network.stop("estop", 100.0, ("r2",))
    near = {("operator", "r1"), ("r1", "operator"), ("r1", "r2"), ("r2", "r1")}
    network.reaches = lambda sender, receiver: (sender, receiver) in near
    network.stop("estop", 20.0, ("r2",))
    assert network.robots["r2"].stops
    assert network.acks()["r2"].via == "r1"


def test_the_operator_gets_an_ack_after_many_relayed_copies() -> None:
    network = VirtualNetwork(1)
    robot = network.robots["r1"]
    stop = Stop(id="s", verb="stop", operator="anna", hops=1)
    for number in range(6):
        robot.peer.on_datagram(stop, (f"10.0.1.{number}", 7440), network.now, robot.summary)
    robot.peer.on_datagram(replace(stop, hops=0), OPERATOR, network.now, robot.summary)
    assert robot.peer.wants_ack(replace(stop, hops=0), OPERATOR, network.now)


def test_parts_of_a_stop_with_many_targets_are_passed_on_one_by_one() -> None:
    network = VirtualNetwork(2)
    names = tuple(f"robot-of-the-long-name-{number:03d}" for number in range(200))
    for start in range(0, 200, 20):
        network.send(Stop(id="s", verb="stop", operator="a", targets=names[start : start + 20]))
    network.sent_kinds.clear()
    network.run(1.0)
    assert network.sent_kinds[Stop] >= 10


def test_solicits_do_not_keep_an_owner_from_answering_a_claimer() -> None:
    network = VirtualNetwork(1)
    owner = network.robots["r1"]
    for number in range(200):
        owner.peer.on_datagram(Solicit(echo=number), OPERATOR, network.now, owner.summary)
    second = network.add("r1", "other")
    network.until(lambda: second.peer.holder is not None, cap=1.0)


@pytest.mark.long
def test_a_question_for_words_costs_as_many_answers_as_it_has_parts() -> None:
    network = VirtualNetwork(60)
    robot = network.robots["r1"]
    answers = 0
    for number in range(100):
        solicit = Solicit(echo=number, wants_members=True)
        effects = robot.peer.on_datagram(solicit, OPERATOR, network.now, robot.summary)
        answers += len(effects.sends)
    assert answers <= 32
    other = robot.peer.on_datagram(
        Solicit(echo=1), ("10.0.0.251", 5000), network.now, robot.summary
    )
    assert other.sends, "the budget of one host is not that of another"


def test_beacons_show_state_and_revision_at_once() -> None:
    network = VirtualNetwork(2)
    network.run(0.35)
    robot = network.robots["r1"]
    robot.state, robot.revision = State.RUNNING, 5
    network.heard.clear()
    network.run(0.15)
    beacons = [body for _, body in network.heard if isinstance(body, Beacon)]
    assert any(body.robot == "r1" and (body.state, body.revision) == (1, 5) for body in beacons)


# Places in a shared frame

POSE = SharedPose(0.0, Pose(1.2345, -2.0, 0.5), error=0.05, yaw_error=0.1, frame="mocap")


def test_a_place_is_sent_ten_times_a_second_at_most_and_only_by_the_owner_of_the_id() -> None:
    network = VirtualNetwork(1)
    peer = network.robots["r1"].peer
    sent = [peer.place(POSE, 0.1, network.now + tick / 20.0) for tick in range(100)]
    assert sum(place is not None for place in sent) == 50
    new = VirtualNetwork(1, joined=False)
    assert new.robots["r1"].peer.place(POSE, 0.1, new.now) is None


def test_a_place_arrives_with_its_error_and_with_the_delay_on_the_way() -> None:
    network = VirtualNetwork(2)
    one, two = network.robots["r1"], network.robots["r2"]
    ages = []
    for number, delay in enumerate([0.3, 0.005, 0.01, 0.005, 0.255, 0.005]):
        now = network.now + number * 0.5
        place = one.peer.place(POSE, 0.1004, now)
        assert place is not None
        effects = two.peer.on_datagram(place, one.address, now + delay, two.summary)
        again = two.peer.on_datagram(place, one.address, now + delay, two.summary)
        assert again.places == []  # by another way
        ages += [told.age for told in effects.places]
    assert ages == pytest.approx([0.101 + 0.25 + FASTEST_DATAGRAM, 0.101 + FASTEST_DATAGRAM],
                                 abs=2e-3)  # fmt: skip
    (told,) = effects.places
    assert (told.robot, told.frame) == ("r1", "mocap")
    assert math.hypot(told.x - 1.2345, told.y + 2.0) + 0.05 <= told.error <= 0.052
    assert told.heading == pytest.approx(0.5, abs=5e-4)


def test_places_of_strangers_and_of_the_own_id_are_ignored() -> None:
    network = VirtualNetwork(2)
    one, two = network.robots["r1"], network.robots["r2"]
    told = {"r1": 0, "r2": 0, "r9": 0}
    for number in range(10):
        now = network.now + number * 0.5
        place = one.peer.place(POSE, 0.1, now)
        assert place is not None
        for robot in told:
            body = replace(place, robot=robot)
            told[robot] += len(two.peer.on_datagram(body, one.address, now, two.summary).places)
    assert told == {"r1": 6, "r2": 0, "r9": 0}


# Clocks


def test_robots_that_record_note_the_clocks_of_a_few_peers_and_others_ask_nothing() -> None:
    network = VirtualNetwork(16)
    network.until(lambda: all_know_each_other(network))
    network.robots["r1"].is_recording = True
    network.sent_kinds.clear()
    network.run(60.0)
    assert 8 * 4 <= network.sent_kinds[ClockQuery] <= 10 * 4  # of r1 alone: 1, 2, 4 and 8 further
    assert network.sent_kinds[ClockReply] == network.sent_kinds[ClockQuery]
    clocks = network.robots["r1"].clocks
    assert len({one.peer for one in clocks}) == 4
    assert all(one.clock == int(one.peer[1:]).to_bytes(6, "big").hex() for one in clocks)
    assert all(one.sent < one.answered <= one.returned < one.sent + 0.2 for one in clocks)
    assert not any(robot.clocks for name, robot in network.robots.items() if name != "r1")


def test_an_answer_that_was_not_asked_for_is_no_clock() -> None:
    network = VirtualNetwork(2)
    network.robots["r1"].is_recording = True
    network.run(1.0)
    before = len(network.robots["r1"].clocks)
    assert before >= 1
    network.send(ClockReply(robot="r2", clock=bytes(6), sent=5, answered=7), "r1")
    network.run(0.1)
    assert len(network.robots["r1"].clocks) == before


def test_kin_reports_of_strangers_earlier_lives_and_the_own_id_are_ignored() -> None:
    network = VirtualNetwork(2)
    one, two = network.robots["r1"], network.robots["r2"]
    report = one.peer.kin_report(KinMessage(7, 1000, 0, 0, 0))
    assert report is not None
    for body, count in (
        (report, 1),
        (replace(report, robot="r2"), 0),
        (replace(report, robot="r9"), 0),
        (replace(report, instance=b"before"), 0),
    ):
        effects = two.peer.on_datagram(body, one.address, network.now, two.summary)
        assert len(effects.kin) == count
    new = VirtualNetwork(1, joined=False)
    assert new.robots["r1"].peer.kin_report(report.message) is None  # it claims its id


def test_forty_robots_that_start_together_share_the_air() -> None:
    """Each claimed 20 times in the second, and each answered each as the claims were won."""
    network = VirtualNetwork(40, joined=False)
    twin = network.add("r1", key="twin")
    network.run(1.1)
    assert network.sent_kinds[Beacon] <= 14 * 41
    assert sum(network.unicast.values()) <= 2  # the owner answers its twin
    owners = [robot for robot in network.robots.values() if robot.peer.owns_id]
    assert len(owners) == 40
    first = network.robots["r1"].peer
    assert first.owns_id is not twin.peer.owns_id
    network.run(0.2)
    others = {f"r{number}" for number in range(2, 41)}
    assert set(first.membership.members(network.now)) == others


def test_a_robot_that_joins_alone_asks_as_it_owns_its_id() -> None:
    network = VirtualNetwork(3)
    network.heard.clear()
    network.add("late")
    before = network.sent_kinds[Solicit]
    network.run(1.2)
    assert network.sent_kinds[Solicit] - before >= 3
