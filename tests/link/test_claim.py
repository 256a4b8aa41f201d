"""The claim of an id on a computer that is busy."""

from __future__ import annotations

import math

import pytest

from swarmd.core.messages import State
from swarmd.link.datagram import STATES, Beacon, Flag
from swarmd.link.members.claim import LONGEST_LOOK, Claim

OWN, OTHER = b"222222", b"111111"


def beacon(instance: bytes, sequence: int, flags: int = 0) -> Beacon:
    state = STATES.index(State.IDLE)
    return Beacon(
        robot="r1", instance=instance, sequence=sequence, wire=1, state=state, revision=0,
        flags=flags,
    )  # fmt: skip


@pytest.mark.parametrize("settle", [0.25, 1.0])
@pytest.mark.parametrize("gap", [0.05, 0.2, 0.5, 3.0])
def test_a_daemon_alone_wins_its_id_after_a_bounded_number_of_looks(
    settle: float, gap: float
) -> None:
    claim = Claim("r1", OWN, settle, 0.0)
    wanted = math.ceil(settle / min(gap, LONGEST_LOOK) - 1e-9)
    won = [claim.is_won(gap * look) for look in range(1, wanted + 1)]
    assert won == [False] * (wanted - 1) + [True]
    assert claim.rivals == ()


def test_after_a_stall_the_beacons_that_waited_count_before_the_claim_is_won() -> None:
    claim = Claim("r1", OWN, 1.0, 0.0)
    assert not claim.is_won(20.0)
    claim.on_beacon(beacon(OTHER, 1), 20.0)
    assert claim.rivals == (OTHER,)
    assert not any(claim.is_won(20.0 + 0.05 * look) for look in range(1, 20))
    claim.on_beacon(beacon(OTHER, 2), 21.0)
    assert claim.holder == OTHER
    assert not claim.is_won(30.0)


def test_a_claimer_of_a_lesser_instance_is_a_rival_until_it_is_silent() -> None:
    claim = Claim("r1", OWN, 0.25, 0.0)
    claim.on_beacon(beacon(OTHER, 1, Flag.JOINING), 0.0)
    assert not claim.is_won(0.3)
    assert list(claim.rivals) == [OTHER]
    assert not claim.is_won(0.5)
    assert claim.is_won(0.6)
    assert not claim.rivals
