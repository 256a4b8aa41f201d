from __future__ import annotations

from msgspec.structs import replace

from swarmd.core.messages import Latch
from swarmd.robot.latches import MAX_CLEARED, MAX_HELD, OVERFLOW, Latches, LatchRecord

SWARM = Latch(issuer="alice", scope="swarm")


def test_reset_clears_only_its_ids() -> None:
    latches = Latches()
    latches.add("a", SWARM, 0.0)
    latches.add("b", SWARM, 0.0)
    latches.clear(["a"])
    assert set(latches.held) == {"b"}


def test_reset_latch_returns_by_estop_but_not_by_a_peer() -> None:
    latches = Latches()
    latches.add("a", SWARM, 0.0)
    latches.clear(["a"])
    assert latches.adopt({"a": SWARM}, 0.0) == ()
    assert not latches.held
    assert latches.add("a", SWARM, 0.0)
    assert set(latches.held) == {"a"}


def test_reset_ids_survive_a_restart() -> None:
    latches = Latches()
    latches.add("a", SWARM, 0.0)
    latches.clear(["a"])
    again = Latches(latches.record())
    assert again.adopt({"a": SWARM, "b": SWARM}, 0.0) == ("b",)


def test_flood_of_estops_stays_latched_within_bounds() -> None:
    latches = Latches()
    for n in range(10_000):
        latches.add(f"e{n}", SWARM, 0.0)
    assert len(latches.held) == MAX_HELD + 1
    assert latches.held[OVERFLOW].scope == "robots"  # the others already hold every peer
    latches.clear(f"e{n}" for n in range(10_000))
    assert set(latches.held) == {OVERFLOW}
    assert len(latches.record().cleared) == MAX_CLEARED


def test_ids_that_were_folded_are_cleared_with_the_rest() -> None:
    latches = Latches()
    for number in range(MAX_HELD + 5):
        latches.add(f"e{number}", SWARM, 0.0)
    last = f"e{MAX_HELD + 4}"
    assert not latches.is_cleared(last)
    latches = Latches(latches.record())  # after a restart
    latches.clear(list(latches.held))
    assert not latches.held
    assert latches.is_cleared(last), "a copy of it that is still relayed latches nothing"


def test_the_age_of_a_latch_counts_from_the_issue_of_the_stop() -> None:
    latches = Latches()
    latches.add("a", replace(SWARM, age=2.0), now=10.0)  # issued at 8 s
    latches.adopt({"b": replace(SWARM, age=5.0)}, now=10.0)  # issued at 5 s, told by a peer
    assert {name: latch.age for name, latch in latches.aged(13.0).items()} == {"a": 5.0, "b": 8.0}
    assert latches.aged(3.0)["a"].age == 0.0, "no message holds a negative age"


def test_a_peer_of_an_older_version_does_not_tell_the_age() -> None:
    latches = Latches()
    latches.adopt({"a": SWARM}, now=10.0)
    assert latches.aged(13.0)["a"].age is None


def test_a_copy_rewrites_neither_who_nor_why_nor_when() -> None:
    latches = Latches()
    latches.add("a", replace(SWARM, reason="smoke", age=0.0), now=10.0)
    record = latches.record()
    forged = Latch(issuer="eve", scope="swarm", reason="all is well", age=900.0)
    assert not latches.add("a", forged, now=11.0)
    assert latches.adopt({"a": forged}, now=11.0) == ()
    assert latches.record() == record, "the file is not written again"
    assert latches.aged(12.0) == {"a": replace(SWARM, reason="smoke", age=2.0)}


def test_ages_go_on_after_a_restart_and_end_with_a_reset() -> None:
    latches = Latches()
    latches.add("a", replace(SWARM, age=0.0), now=10.0)
    again = Latches(latches.record(), now=50.0)
    assert again.aged(60.0)["a"].age == 50.0
    replayed = Latches(LatchRecord(held=again.aged(60.0)), now=60.0)  # as the head of a recording
    assert replayed.aged(61.0)["a"].age == 51.0
    again.clear(["a"])
    again.add("a", SWARM, now=70.0)
    assert again.aged(71.0)["a"].age is None


def test_the_latch_for_all_further_ones_has_the_age_of_the_newest() -> None:
    latches = Latches()
    for number in range(MAX_HELD + 3):
        latches.add(f"e{number}", replace(SWARM, age=0.0), now=float(number))
    latches.add(f"e{MAX_HELD}", replace(SWARM, age=0.0), now=99.0)  # a copy
    assert latches.aged(100.0)[OVERFLOW].age == 100.0 - (MAX_HELD + 2)


def test_an_emergency_stop_of_single_robots_does_not_spread() -> None:
    """Only a latch of scope `swarm` spreads to robots that join (link/datagram.py, `Stop`)."""
    own = Latch(issuer="alice", scope="robots")
    latches = Latches()
    assert latches.adopt({"a": own, "b": SWARM}, 0.0) == ("b",)
    assert set(latches.held) == {"b"}


def test_the_latch_for_all_further_ones_stands_for_any_of_a_peer() -> None:
    latches = Latches()
    for number in range(MAX_HELD + 1):
        latches.add(f"e{number}", SWARM, 0.0)
    assert latches.adopt({"of a peer": SWARM}, 0.0) == ()
    latches.clear([OVERFLOW])
    assert latches.adopt({"of a peer": SWARM}, 0.0) == ("of a peer",)
