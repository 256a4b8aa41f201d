"""ROS2swarm's own nodes, unmodified, on robots of three platforms.

Its sources are not kept here: SWARMD_ROS2SWARM names the folder `src` of a checkout. The tests are
skipped without it. docs/ros2_nodes.md has the commit.
"""

from __future__ import annotations

import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from studies.ros2swarm import (
    BOTH,
    OURS,
    PATTERNS,
    RANGE,
    Task,
    digest,
    perform,
    write_launch,
)
from swarmd.core.errors import PluginError
from swarmd.core.values import Inputs, Outputs, Value
from swarmd.kit.factory import assemble
from swarmd.pattern_host.loader import PatternLoader
from swarmd.plugins import pattern_names
from swarmd.ros2_nodes.robot_nodes import RobotNodes
from swarmd.settings.settings import load_platform
from swarmd.testing.scans import Disc, scan_from, scan_of

VARIABLE = "SWARMD_ROS2SWARM"
SOURCE = Path(os.environ.get(VARIABLE, "/nowhere"))
pytestmark = [
    pytest.mark.skipif(
        not (SOURCE / "ros2swarm").is_dir(),
        reason=f"{VARIABLE} names no folder src of a checkout of ROS2swarm",
    ),
    # Their code uses np.matrix.
    pytest.mark.filterwarnings("ignore::PendingDeprecationWarning"),
]
NOT_HERE = {"rat_search": "cv2", "voter_model_with_limiter": "subprocess"}
"""By pattern, what its line names when it is loaded."""
FAULTS = {("minimalist_flocking", "jackal"): "IndexError"}
"""Their file for the Jackal has no `minimalist_flocking_zone_borders`, of which they need four."""
MOVES = {"attraction", "attraction2", "dispersion", "drive", "random_walk", "aggregation"} | {
    "minimalist_flocking"
}


def run(path: Path, platform: str, seconds: float, *discs: Disc) -> list[Outputs]:
    """The outputs at 10 Hz, with a scan at every second step of these discs around the robot."""
    known = load_platform(platform)
    nodes = RobotNodes(path, "tb3-01", known, np.random.default_rng(1))
    scan = scan_of(known, discs)
    return [
        nodes.step(Inputs(0.1 * n, 0.1, scan=scan, is_new_scan=n % 2 == 0))
        for n in range(round(seconds * 10.0))
    ]


@pytest.mark.parametrize("platform", ["burger", "waffle_pi", "jackal"])
@pytest.mark.parametrize("pattern", PATTERNS)
def test_a_pattern_runs_or_says_why_not(tmp_path: Path, pattern: str, platform: str) -> None:
    path = write_launch(tmp_path, SOURCE.absolute(), pattern, BOTH)
    if pattern in NOT_HERE:
        with pytest.raises(PluginError, match=NOT_HERE[pattern]):
            run(path, platform, 0.1)
        return
    if (pattern, platform) in FAULTS:
        with pytest.raises(PluginError, match=FAULTS[pattern, platform]):
            run(path, platform, 0.1)
        return
    outputs = run(path, platform, 6.0, Disc(1.5, 0.5))
    twists = [one.twist for one in outputs if one.twist is not None]
    assert any(not twist.is_zero for twist in twists) == (pattern in MOVES)


def test_votes_go_to_the_other_robots_with_the_number_of_the_robot(tmp_path: Path) -> None:
    path = write_launch(tmp_path, SOURCE.absolute(), "majority_rule", OURS)
    sent: list[Any] = [one.messages["topics"] for one in run(path, "burger", 6.0) if one.messages]
    ((number, (robot, opinion)),) = sent[0]
    assert (number, robot) == (0, 1)
    assert opinion in range(3)


def test_alone_in_the_range_of_the_hardware_a_robot_turns_on_the_spot(tmp_path: Path) -> None:
    """`attraction_angular_if_alone: 1.0`, with a robot at 1.5 m, beyond 0.8 m."""
    path = write_launch(tmp_path, SOURCE.absolute(), "attraction", OURS, RANGE)
    last = run(path, "waffle_pi", 1.0, Disc(1.5, 0.5))[-1].twist
    assert last is not None
    assert (last.linear, last.angular) == (0.0, 1.0)


@pytest.mark.parametrize("pattern", ["attraction", "dispersion"])
def test_our_rewrite_commands_what_their_node_commands_for_the_same_scan(
    tmp_path: Path, pattern: str
) -> None:
    """To the rounding of a `LaserScan`, whose ranges and angles have 32 bits."""
    platform = load_platform("waffle_pi")
    # A robot that is alone turns by their file; by default our dispersion stands.
    of_their_file: tuple[tuple[str, Mapping[str, Value]], ...] = (
        ("request", {"law": "paper", "angular_if_alone": 1.0}),
    )
    ours = assemble(
        pattern,
        of_their_file,
        find=PatternLoader(
            {name: (one.value, one.is_file) for name, one in pattern_names(None).items()}
        ),
        robot="tb3-01",
        platform=platform,
        rng=np.random.default_rng(1),
    ).pattern
    path = write_launch(tmp_path, SOURCE.absolute(), pattern, OURS)
    theirs = RobotNodes(path, "tb3-01", platform, np.random.default_rng(1))
    rng = np.random.default_rng(2)
    for number in range(40):
        ranges = rng.uniform(0.05, 4.0, 360)
        ranges[rng.random(360) < 0.5] = np.inf
        for odd in (np.nan, np.inf, -np.inf):
            ranges[rng.integers(0, 360)] = odd
        if number % 4 == 0:
            ranges[rng.random(360) < 0.99] = np.inf  # alone, or nearly so
        scan = scan_from(platform, ranges, platform.scan.bearings, seq=number)
        inputs = Inputs(0.2 * number, 0.2, scan=scan, is_new_scan=True)
        wanted = theirs.step(inputs).twist
        found = ours.step(inputs).twist
        assert wanted is not None
        assert found is not None
        assert found.linear == pytest.approx(wanted.linear, abs=1e-4)
        assert found.angular == pytest.approx(wanted.angular, abs=1e-4)


@pytest.mark.long
def test_the_short_form_of_experiment_1_is_that_of_its_row() -> None:
    """6 s of seed 0 in the arena of 18 x 18 m, as they were on 2026-11-30.

    Until rays stood as the sensor measured them, `end` was 1.6105 and `way` 0.6195.
    """
    task = Task(arena="arena", row="nodes", seed=0, sources=digest(SOURCE.absolute()), duration=6.0)
    found = perform(task).found
    assert found.failure == ""
    assert (found.end, found.way) == pytest.approx((1.5820, 0.6294), abs=0.001)
