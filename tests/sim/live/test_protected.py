"""Real daemons in real time, with things that appear in their way and a body that rams them."""

from __future__ import annotations

import pytest

from studies.safety.live import Course, is_ram

SECONDS = 60.0  # of simulation, at most: it ends as soon as enough has come in their way
GRAZE = 0.05
"""m/s. Who turns on the spot as it is rammed may close by a little more than 2 cm/s."""


@pytest.mark.integration
def test_seven_daemons_drive_into_nothing_that_comes_in_their_way() -> None:
    with Course("burger", "barrier", seed=1) as course:
        outcome = course.run(SECONDS, appeared=8, touches=2)
    assert outcome.appeared >= 8
    assert sum(is_ram(touch) for touch in outcome.touches()) >= 2
    assert [fault for fault in outcome.faults() if not is_ram(fault)] == []
    assert max((fault.own_speed for fault in outcome.faults()), default=0.0) <= GRAZE
    assert max(outcome.ram_speeds()) <= course.others_speed + 1e-3
