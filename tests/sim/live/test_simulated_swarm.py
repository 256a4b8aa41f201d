"""What `swarmd.demo` refuses before it starts a process; the notebooks of examples/ start some."""

from __future__ import annotations

import os
from typing import Any

import pytest

import swarmd
from swarmd.core.errors import ConfigError, SwarmError
from tests.support.processes import children


@pytest.mark.parametrize(
    ("values", "subject"),
    [
        ({"robots": 0}, "robots"),
        ({"robots": 51}, "robots"),
        ({"swarm": "My Swarm"}, "My Swarm"),
        ({"platform": "waffel_pi"}, "waffle_pi"),
        ({"set": {"duration": 3}}, "duration"),
        ({"scenario": "agregation"}, "aggregation"),
        ({"robots": 40, "arena": "1x1"}, "room|fit|arena"),
    ],
)
def test_a_demo_that_cannot_be_starts_no_process(values: dict[str, Any], subject: str) -> None:
    before = {*children(os.getpid())}
    with pytest.raises(ConfigError, match=subject):
        swarmd.demo(**values).start()
    assert {*children(os.getpid())} <= before  # one of an earlier test may end


def test_a_demo_that_has_not_started_knows_no_pose() -> None:
    demo = swarmd.demo()
    assert demo.robots == ()
    with pytest.raises(SwarmError, match="started"):
        demo.poses()
    demo.close()
