from __future__ import annotations

from swarmd.core.messages import Latch
from swarmd.robot.latches import MAX_CLEARED, MAX_HELD, OVERFLOW, Latches

SWARM = Latch(issuer="alice", scope="swarm")


def test_reset_clears_only_its_ids() -> None:
    latches = Latches()
    latches.add("a", SWARM)
    latches.add("b", SWARM)
    latches.clear(["a"])
    assert set(latches.held) == {"b"}


def test_reset_latch_returns_by_estop_but_not_by_a_peer() -> None:
    latches = Latches()
    latches.add("a", SWARM)
    latches.clear(["a"])
    assert latches.adopt({"a": SWARM}) == ()
    assert not latches.held
    assert latches.add("a", SWARM)
    assert set(latches.held) == {"a"}


def test_reset_ids_survive_a_restart() -> None:
    latches = Latches()
    latches.add("a", SWARM)
    latches.clear(["a"])
    again = Latches(latches.record())
    assert again.adopt({"a": SWARM, "b": SWARM}) == ("b",)


def test_flood_of_estops_stays_latched_within_bounds() -> None:
    latches = Latches()
    for n in range(10_000):
        latches.add(f"e{n}", SWARM)
    assert len(latches.held) == MAX_HELD + 1
    assert latches.held[OVERFLOW].scope == "robots"  # the others already hold every peer
    latches.clear(f"e{n}" for n in range(10_000))
    assert set(latches.held) == {OVERFLOW}
    assert len(latches.record().cleared) == MAX_CLEARED


def test_ids_that_were_folded_are_cleared_with_the_rest() -> None:
    latches = Latches()
    for number in range(MAX_HELD + 5):
        latches.add(f"e{number}", SWARM)
    last = f"e{MAX_HELD + 4}"
    assert not latches.is_cleared(last)
    latches = Latches(latches.record())  # after a restart
    latches.clear(list(latches.held))
    assert not latches.held
    assert latches.is_cleared(last), "a copy of it that is still relayed latches nothing"
