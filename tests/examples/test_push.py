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


def test_the_grant_in_its_docstring_covers_its_zone() -> None:
    granted = TouchZone(0.0, math.radians(20.0), 0.1)  # as its docstring configures it
    assert "touch: {push: {half_width_deg: 20, speed: 0.1}}" in (EXAMPLES / "push.py").read_text()
    assert effective_zone("push", load().touches, granted)[0] == granted


def test_its_recovery_is_off() -> None:
    assert load().params_type().recovery is False
