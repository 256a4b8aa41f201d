"""How goals spread between robots: convergence, ages, and what forged or recorded answers do."""

from __future__ import annotations

from typing import Any

import pytest
from cryptography.hazmat.primitives.asymmetric import ec
from msgspec import convert, to_builtins
from msgspec.structs import replace

from swarmd.core.bounds import MAX_SECONDS
from swarmd.core.events import GoalInput
from swarmd.core.goal import MAX_UNSIGNED, Goal, HeldGoal, digest_of, encode_goal, signed_part
from swarmd.link.datagram import MAX_MS, GoalReport, Solicit
from swarmd.link.keys.content_signature import Purpose, sign
from swarmd.link.keys.private_keys import public_bytes
from swarmd.link.spread.goal_sync import CHECK_BURST, GoalCheck, GoalSync
from tests.link.virtual_network import VirtualNetwork
from tests.support.keys import flipped

INSTANCE = b"abcdef"
SOURCE = ("10.0.0.1", 7440)


def goal(generation: int = 1, issuer: str = "bob", **fields: Any) -> Goal:
    fields = {"id": f"g{generation}{issuer}", "pattern": "flocking", **fields}
    return Goal(generation=generation, issuer=issuer, **fields)


def agree(network: VirtualNetwork, wanted: Goal) -> bool:
    held = [robot.goals.held for robot in network.robots.values() if robot.is_up]
    return all(one is not None and one.goal == wanted for one in held)


def spread(network: VirtualNetwork, wanted: Goal) -> float:
    """Seconds until all hold the goal."""
    return network.until(lambda: agree(network, wanted), 30.0)


@pytest.mark.long
def test_a_goal_of_one_robot_reaches_a_hundred() -> None:
    network = VirtualNetwork(100, settle=0.1, joined=False)  # a long claim costs the test seconds
    network.run(0.5)
    network.robots["r7"].find(goal(), 0.0, network.now)
    before = network.sent_kinds[Solicit]
    assert spread(network, goal()) < 2.0
    assert network.sent_kinds[Solicit] - before < 600


@pytest.mark.parametrize("loss", [0.1, 0.3])
def test_a_late_joiner_gets_the_goal_over_a_link_with_losses(loss: float) -> None:
    network = VirtualNetwork(3)
    network.robots["r1"].find(goal(), 0.0, network.now)
    network.run(3.0)
    network.loss = loss
    joiner = network.add("late").peer
    network.until(lambda: joiner.owns_id)
    assert spread(network, goal()) < 2.0


def test_two_sides_of_a_cut_agree_on_the_greater_goal() -> None:
    network = VirtualNetwork(20)
    left = {f"r{number}" for number in range(1, 11)}
    network.reaches = lambda sender, receiver: (sender in left) is (receiver in left)
    network.robots["r1"].find(goal(5, "zoe"), 0.0, network.now)
    network.robots["r20"].find(goal(6, "anna"), 0.0, network.now)
    network.run(20.0)
    assert network.robots["r2"].goals.held.goal.issuer == "zoe"  # type: ignore[union-attr]
    network.reaches = lambda sender, receiver: True
    assert spread(network, goal(6, "anna")) < 2.0
    network.run(1.0)
    quiet = network.sent_kinds[GoalReport]
    network.run(5.0)
    assert network.sent_kinds[GoalReport] == quiet, "nothing is sent while all agree"


def test_ages_are_handed_on_along_a_line() -> None:
    network = VirtualNetwork(4, joined=False)
    network.reaches = lambda sender, receiver: (
        abs(int(sender[1:] or 0) - int(receiver[1:] or 0)) == 1
        if sender[0] == receiver[0] == "r"
        else False
    )
    network.run(3.0)
    began = network.now
    network.robots["r1"].find(goal(), 7.0, began)
    spread(network, goal())
    network.run(10.0)
    for robot in network.robots.values():
        age = robot.goals.held.age(network.now)  # type: ignore[union-attr]
        assert age is not None
        assert 0.0 <= age - (network.now - began + 7.0) < 1.0


@pytest.mark.parametrize("fields", [{"on_join": "run", "valid": 60.0}, {}])
def test_a_restarted_robot_learns_the_age_of_its_goal(fields: dict[str, Any]) -> None:
    network = VirtualNetwork(3)
    wanted = goal(**fields)
    for robot in network.robots.values():
        robot.find(wanted, 5.0, network.now)
    network.robots["r2"].goals.held = HeldGoal.of(wanted, None)
    network.until(lambda: network.robots["r2"].goals.held.issued is not None, 2.5)  # type: ignore[union-attr]


def test_goals_with_invalid_signatures_are_dropped_counted_and_not_asked_for_again() -> None:
    network = VirtualNetwork(2)
    network.robots["r1"].find(goal(9), 0.0, network.now)
    strict = network.add("strict", check_goal=lambda one, now: one.generation < 9)
    network.run(10.0)
    assert strict.goals.held is None
    assert 1 <= strict.invalid_goals <= 2, "once for each robot that holds it"


def test_an_answer_to_no_question_brings_nothing() -> None:
    sync = GoalSync(1)
    content = encode_goal(goal())
    report = GoalReport(robot="r1", instance=INSTANCE, echo=0, goal=content, age=0)
    assert sync.on_report(report, 0.0) is None
    echo = sync.wants(INSTANCE, digest_of(goal()), SOURCE, None, 1.0)
    assert echo is not None
    other = GoalReport(robot="r2", instance=b"ghijkl", echo=echo, goal=content, age=0)
    assert sync.on_report(other, 1.1) is None
    echo = sync.wants(INSTANCE, digest_of(goal()), SOURCE, None, 1.5)
    assert echo is not None
    answer = GoalReport(robot="r1", instance=INSTANCE, echo=echo, goal=content, age=1000)
    found = sync.on_report(answer, 1.7)
    assert found is not None
    assert found.age == pytest.approx(1.2)
    assert sync.on_report(answer, 1.8) is None, "a recorded answer"


def test_an_answer_with_the_greatest_age_brings_an_input_that_can_be_recorded() -> None:
    sync = GoalSync(1)
    echo = sync.wants(INSTANCE, digest_of(goal()), SOURCE, None, 1.0)
    assert echo is not None
    report = GoalReport(
        robot="r1", instance=INSTANCE, echo=echo, goal=encode_goal(goal()), age=MAX_MS
    )
    found = sync.on_report(report, 1.2)
    assert found is not None
    content = to_builtins(GoalInput(found.goal, found.age, found.may_join))
    assert convert(content, GoalInput).age == MAX_SECONDS


def test_beacons_of_many_strangers_cost_a_bounded_number_of_questions() -> None:
    sync, asked = GoalSync(1), 0
    for number in range(1, 5000):
        digest = digest_of(goal(number))
        asked += sync.wants(number.to_bytes(6, "big"), digest, SOURCE, None, 1.0) is not None
    assert asked <= 20
    assert sync.wants(INSTANCE, b"xx", SOURCE, None, 5.0) is None


class _Signing:
    def __init__(self) -> None:
        self._key = ec.generate_private_key(ec.SECP256R1())
        self.public = public_bytes(self._key.public_key())

    def sign(self, one: Goal) -> Goal:
        return replace(one, signature=sign(self._key, Purpose.GOAL, signed_part(one)))


def test_a_goal_counts_only_with_the_signature_of_its_issuer() -> None:
    bob, eve = _Signing(), _Signing()
    check = GoalCheck({"bob": bob.public, "eve": eve.public}.get)
    assert check(bob.sign(goal()), 0.0) is True
    assert check(eve.sign(goal()), 0.0) is False
    assert check(goal(), 0.0) is False
    assert check(bob.sign(goal(issuer="nobody")), 0.0) is False
    assert check(goal(pattern=None), 0.0) is True, "it only stops"
    assert check(goal(MAX_UNSIGNED + 1, pattern=None), 0.0) is False, "none could be greater"
    assert check(bob.sign(goal(MAX_UNSIGNED + 1)), 0.0) is True


def test_signatures_are_verified_once_and_at_a_limited_rate() -> None:
    bob, eve = _Signing(), _Signing()
    check = GoalCheck({"bob": bob.public}.get)
    good = bob.sign(goal())
    assert check(good, 0.0) is True
    forged = [eve.sign(goal(number)) for number in range(1, 20)]
    verdicts = [check(one, 0.0) for one in forged]
    assert verdicts.count(False) == CHECK_BURST - 1
    assert verdicts.count(None) > 0
    assert check(good, 0.0) is True, "it was verified before"


def test_a_flipped_signature_does_not_count_and_costs_no_check() -> None:
    bob = _Signing()
    check = GoalCheck({"bob": bob.public}.get)
    good = bob.sign(goal())
    bad = replace(good, signature=flipped(good.signature))
    for _ in range(100):
        assert check(bad, 0.0) is False
    assert check(good, 0.0) is True


def test_no_robot_asks_for_the_goal_that_it_holds_with_another_signature() -> None:
    network = VirtualNetwork(3)
    held = goal(7, signature=bytes(64))
    for robot in network.robots.values():
        robot.find(held, 0.0, network.now)
    network.run(2.0)
    asked = network.sent_kinds[GoalReport]
    thief = network.robots["r3"].goals
    thief.held = HeldGoal.of(replace(held, signature=b"\xff" * 64), network.now)
    network.run(5.0)
    assert network.sent_kinds[GoalReport] == asked
    for name in ("r1", "r2"):
        assert network.robots[name].goals.held.goal == held  # type: ignore[union-attr]
