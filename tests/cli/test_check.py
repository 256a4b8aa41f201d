"""What `swarmd --check` says of protection, for each mode."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, get_args

import pytest

from swarmd.cli.check import protection_text
from swarmd.platforms import load_platform
from swarmd.protection.settings import Mode


def told(platform: str, mode: str) -> Mapping[str, Any]:
    return {**load_platform(platform).protection, "mode": mode}


@pytest.mark.parametrize("mode", get_args(Mode))
def test_the_mode_in_force_comes_first(mode: str) -> None:
    assert protection_text(told("jackal", mode)).startswith(mode)


def test_the_main_numbers_of_each_mode_are_said() -> None:
    barrier = load_platform("jackal").protection["barrier"]
    text = protection_text(told("jackal", "barrier"))
    for name in ("others_speed", "unseen_extent", "margin", "braking_linear", "keep_out"):
        assert f" {barrier[name]:g} m" in text, name
    assert "of the sensor" in text
    assert "of the sensor" not in protection_text(told("burger", "barrier"))
    assert protection_text(told("burger", "potential_field")) == (
        "potential_field (paper) within 0.5 m"
    )
    assert protection_text(told("burger", "stop_zone")) == (
        "stop_zone: stops within 0.1 m, 30% of the wish within 0.25 m"
    )
    assert protection_text(told("burger", "off")) == "off: nothing keeps it from touching anything"
