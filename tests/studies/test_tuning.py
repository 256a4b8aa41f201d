"""The command of the study of tuning, in short: its table has the held-out seeds and a control."""

from __future__ import annotations

from pathlib import Path

import pytest

from studies import keeper, tuning

pytestmark = pytest.mark.long


def test_present_tuned_and_standing_robots_are_rows(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    group, shown, search = tuning.SEARCHES["tuned_dispersion"]
    short = {**search, "set": {"groups.tb3.count": 2, "duration": 3}, "param": ("speed=0.05,0.06",)}
    monkeypatch.setattr(tuning, "SEARCHES", {"tuned_dispersion": (group, shown, short)})
    monkeypatch.setattr(keeper, "experiment_folder", lambda study: tmp_path / study)
    monkeypatch.setattr("sys.argv", ["tuning", "--seeds", "1", "--jobs", "1"])
    tuning.main()
    lines = [line for line in capsys.readouterr().out.splitlines() if line]
    assert lines[0] == "<!-- results: tuned_dispersion -->"
    head, _, *rows = [[cell.strip() for cell in line.strip("|").split("|")] for line in lines[1:6]]
    assert head[1] == "mean way [m]"
    ways = {name: float(way.split()[0]) for name, way, *_ in rows}
    assert ways["robots that never move"] == 0.0
    assert ways["`speed: 0.05`"] < ways["default"]  # a slower robot has a shorter way in 3 s
    assert "held-out seeds 2 to 3" in lines[6]
