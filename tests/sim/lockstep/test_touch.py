"""Touch zones in lockstep: only if requested and granted, at the granted speed."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from swarmd.sim.lockstep.lockstep import simulate_run
from swarmd.sim.scenarios.scenariofile import scenario_of
from swarmd.sim.trace import Trace

EXAMPLES = Path(__file__).resolve().parents[3] / "examples"
AHEAD = {"half_width_deg": 20, "speed": 0.1}
SLIPS = 0.015
"""m/s by which realistic wheels and the push back of a crate exceed what was commanded."""


def pushed(
    platform: str = "burger",
    touch: dict[str, Any] | None = None,
    *,
    start: float = -0.6,
    width: float = 0.1,
    events: tuple[dict[str, Any], ...] = (),
    duration: float = 12.0,
    **parameters: float,
) -> Trace:
    """A robot drives at a light crate around 0.4 m from the middle of the room."""
    scenario = scenario_of(
        {
            "duration": duration,
            "plugin_dir": str(EXAMPLES),
            "arena": {
                "size": [1.0 - 4.0 * start, 3.0],
                "boxes": [{"name": "crate", "at": [0.4, 0.0], "size": [0.3, width], "mass": 0.5}],
            },
            "platforms": {platform: {"protection": {"mode": "barrier"}}},
            "groups": {
                "all": {
                    "platform": platform,
                    "count": 1,
                    "pattern": "push",
                    "parameters": parameters,
                    "touch": touch or {},
                    "start": {"layout": "list", "poses": [[start, 0.0, 0.0]]},
                }
            },
            "events": list(events),
        }
    )
    return simulate_run(scenario, seed=1)


def moved(trace: Trace, since: float = 0.0) -> float:
    """m that the crate was moved ahead."""
    assert trace.box_pose is not None
    later = trace.box_pose[trace.t >= since, 0, 0]
    return float(later[-1] - later[0])


@pytest.mark.parametrize(
    ("platform", "start"),
    [("burger", -0.6), ("waffle_pi", -0.6), ("jackal", -1.2)],  # Jackal's sees nothing in 0.8 m
)
def test_a_granted_touch_request_pushes_a_box(platform: str, start: float) -> None:
    trace = pushed(platform, {"push": AHEAD}, start=start, duration=18)
    assert moved(trace) > 0.1
    assert trace.contact_speed[:, 0].max() <= AHEAD["speed"] + SLIPS


def test_a_granted_speed_holds_when_the_lidar_loses_the_box() -> None:
    trace = pushed(touch={"push": {"half_width_deg": 20, "speed": 0.06}}, duration=20, speed=0.2)
    assert moved(trace) > 0.1
    assert trace.contact_speed[:, 0].max() <= 0.06 + SLIPS


@pytest.mark.parametrize(
    "touch",
    [
        {},
        {"drive": AHEAD},
        {"push": {"bearing_deg": 90, **AHEAD}},
    ],
)
def test_nothing_is_touched_without_a_grant(touch: dict[str, Any]) -> None:
    trace = pushed(touch=touch)
    assert not len(trace.contact_t)
    assert moved(trace) == pytest.approx(0.0, abs=1e-3)


def test_a_touch_zone_narrower_than_the_robot_is_not_reached() -> None:
    trace = pushed(touch={"push": AHEAD}, width=0.4)
    assert not len(trace.contact_t)


def test_the_next_pattern_presses_no_further() -> None:
    drive = {"at": 10, "run": "drive", "parameters": {"recovery": False, "speed": 0.1}}
    trace = pushed(touch={"push": AHEAD}, events=(drive,), duration=14)
    assert trace.contact_t.max() > 9.0
    assert moved(trace, since=10.5) == pytest.approx(0.0, abs=0.005)
