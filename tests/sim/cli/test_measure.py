"""`swarmctl exp measure`: one code for traces of any kind."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner

from swarmd.core.errors import ConfigError
from swarmd.settings.platforms import load_platform
from swarmd.sim.cli.exp import exp
from swarmd.sim.trace import TraceBuilder


@pytest.fixture
def live(tmp_path: Path) -> Path:
    """What a real-time world records: poses and commands, and no word of the robots'."""
    recorder = TraceBuilder(
        ("a", "b"), [load_platform("burger")] * 2, {"thresholds": {"burger": 0.5}}
    )
    for k in range(11):
        pose = np.zeros((2, 3))
        pose[1, 0] = 3.0 - 0.1 * k
        recorder.add(0.1 * k, pose, np.zeros((2, 3)))
    recorder.trace().save(tmp_path / "live.npz")
    return tmp_path / "live.npz"


def test_a_live_trace_is_measured_and_what_it_lacks_is_left_empty(live: Path) -> None:
    names = "mean_distance_to_centroid_end,robot_contacts,protection_duty"
    done = CliRunner().invoke(exp, ["measure", str(live), "--metrics", names, "-o", "json"])
    assert done.exit_code == 0, done.output
    found = json.loads(done.output)["traces"][str(live)]
    assert found == {
        "mean_distance_to_centroid_end": pytest.approx(1.0),
        "robot_contacts": 0.0,
        "protection_duty": None,
    }


def test_traces_are_shown_side_by_side_those_of_one_name_with_their_folders(live: Path) -> None:
    again, other = live.with_name("again.npz"), live.parent / "other" / live.name
    other.parent.mkdir()
    for path in (again, other):
        path.write_bytes(live.read_bytes())
    for second, heads in ((again, ["LIVE", "AGAIN"]), (other, [str(live), str(other)])):
        words = ["measure", str(live), str(second), "--metrics", "path_length, mean_speed"]
        done = CliRunner().invoke(exp, words)
        assert done.exit_code == 0, done.output
        head, *rows = (line.split() for line in done.output.splitlines())
        assert head == ["METRIC", "UNIT", *heads]
        assert rows[0] == ["path_length", "m", "0.5", "0.5"]
        assert rows[1][0] == "mean_speed"


def test_an_unknown_metric_and_a_file_that_is_no_trace_are_named(live: Path) -> None:
    with pytest.raises(ConfigError, match="path_length"):
        CliRunner().invoke(
            exp, ["measure", str(live), "--metrics", "path_lenght"], catch_exceptions=False
        )
    with pytest.raises(ConfigError, match="--metrics"):
        CliRunner().invoke(exp, ["measure", str(live), "--metrics", ","], catch_exceptions=False)
    wrong = live.with_name("none.npz")
    wrong.write_text("no trace")
    with pytest.raises(ConfigError, match=r"none\.npz: not a trace"):
        CliRunner().invoke(exp, ["measure", str(wrong)], catch_exceptions=False)
