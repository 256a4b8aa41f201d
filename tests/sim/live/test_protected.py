"""Real daemons in real time, with things that appear in their way and a body that rams them."""

from __future__ import annotations

import pytest

from benchmarks.safety.live import RAMMER, Course

SECONDS = 60.0  # of simulation, at most: it ends as soon as enough has come in their way


@pytest.mark.integration
def test_seven_daemons_drive_into_nothing_that_comes_in_their_way() -> None:
    with Course("burger", "barrier", seed=1) as course:
        outcome = course.run(SECONDS, appeared=8, touches=2)
    touches = outcome.touches()
    assert outcome.appeared >= 8
    assert sum(RAMMER in (touch.a, touch.b) for touch in touches) >= 2
    assert outcome.faults() == []
    assert max(outcome.ram_speeds()) <= course.others_speed + 1e-3
