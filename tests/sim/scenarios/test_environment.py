"""Arena, fields and radio from a scenario's file, in SI units."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from swarmd.sim.world.arena import Arena, Box, Pole, Segment
from swarmd.sim.world.scalar_fields import GaussianField

if TYPE_CHECKING:
    from tests.sim.scenarios.conftest import Load


def test_an_arena_has_all_that_the_file_names(load: Load) -> None:
    assert load().arena == Arena(
        8.0,
        6.0,
        boxes=(
            Box(3.0, 2.0, 0.5, 0.4, math.pi / 4.0, "crate", 2.0),
            Box(0.0, 0.0, 0.5, 0.5, 0.0, "spare", 2.0, is_placed=False),
            Box(-3.0, 2.0, 0.5, 0.4, 0.0, "block"),
        ),
        poles=(Pole(3.0, -2.0, 0.1),),
        segments=(Segment(-3.0, -2.0, -2.0, -2.0),),
    )


def test_fields_and_radio_are_the_worlds_own(load: Load) -> None:
    scenario = load({"radio": {"neighborhood": "range", "range": 2, "loss": 0.1}})
    assert scenario.fields == (GaussianField(name="light", sigma=2.0),)
    assert (scenario.radio.neighborhood, scenario.radio.range) == ("range", 2.0)
    assert (scenario.radio.loss, scenario.radio.delay) == (0.1, 0.0)
