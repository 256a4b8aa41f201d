"""The example that touches, found and loaded as a user's own file would be."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

from swarmd.core.values import TouchZone
from swarmd.kit.behavior import Pattern
from swarmd.kit.touch import effective_zone
from swarmd.pattern_host.loader import PatternLoader
from swarmd.plugins import find_pattern
from swarmd.testing.pattern_contract import PatternContract

EXAMPLES = Path(__file__).resolve().parents[2] / "examples"


def load() -> type[Pattern[Any]]:
    origin = find_pattern("push", EXAMPLES)
    return PatternLoader({"push": (origin.value, origin.is_file)})("push")


class TestPush(PatternContract):
    pattern = load()


def test_it_may_touch_all_that_it_asks_for_as_its_text_says_it_is_granted() -> None:
    granted = TouchZone(0.0, math.radians(20.0), 0.1)  # what its own text tells to configure
    assert "touch: {push: {half_width_deg: 20, speed: 0.1}}" in (EXAMPLES / "push.py").read_text()
    assert effective_zone("push", load().touches, granted)[0] == granted


def test_it_is_not_led_around_what_it_pushes() -> None:
    assert load().params_type().recovery is False
