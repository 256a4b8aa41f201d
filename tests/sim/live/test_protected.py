"""Real daemons in real time: boxes appear in their way, and an unprotected robot rams them."""

from __future__ import annotations

import pytest

from studies.safety.live import is_ram, rows, run_course

SECONDS = 60.0  # of simulation, at most: a run ends as soon as enough has appeared
GRAZE = 0.05
"""m/s. A robot that turns on the spot while it is rammed may close by a little over 2 cm/s."""


@pytest.mark.integration
@pytest.mark.parametrize(
    ("robots", "appeared", "rams"), [(3, 2, 1), pytest.param(7, 8, 2, marks=pytest.mark.evidence)]
)
def test_daemons_drive_into_nothing_that_appears(robots: int, appeared: int, rams: int) -> None:
    outcome = run_course(
        "burger", "barrier", SECONDS, robots=robots, appeared=appeared, touches=rams
    )
    assert outcome.appeared >= appeared
    assert sum(is_ram(touch) for touch in outcome.collisions()) >= rams
    assert [fault for fault in outcome.faults() if not is_ram(fault)] == []
    assert max((fault.own_speed for fault in outcome.faults()), default=0.0) <= GRAZE
    assert max(outcome.ram_speeds()) <= outcome.others_speed + 1e-3
    assert [row.cells()[0] for row in rows("burger", outcome)]
