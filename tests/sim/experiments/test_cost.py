"""What a run costs is known from recorded runs of the same software, or from a calibration."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from swarmd.sim.experiments import cost
from swarmd.sim.experiments.cost import Cost, measured_cost
from swarmd.sim.experiments.manifest import write_json
from swarmd.sim.experiments.simulate import simulate


def test_recorded_runs_tell_the_cost_unless_they_were_made_otherwise(
    duo: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    folder = tmp_path / "experiments"
    simulate(duo, seeds=2, set={"duration": 1}, out=folder / "duo-1")
    table, path = folder / "duo-1" / "runs.csv", folder / "duo-1" / "manifest.json"
    head, *rows = table.read_text().splitlines()
    first, second = (row.rpartition(",")[0] for row in rows)
    table.write_text(f"{head}\n{first},3.000\n{second},5.000\n")
    (folder / "damaged").mkdir()
    (folder / "damaged" / "manifest.json").write_text("{}")
    found = measured_cost(folder)
    assert found.basis.startswith(f"2 recorded runs in {folder}/")
    # The median of 3 and 5 s, for two robots and one second.
    assert found.run_seconds(str(duo), 2, 1.0) == pytest.approx(4.0)
    assert found.run_seconds("another", 4, 10.0) == pytest.approx(80.0)
    calibration = Cost(1.0, {}, "a calibration")
    monkeypatch.setattr(cost, "_calibrated", lambda: calibration)
    manifest = json.loads(path.read_text())
    for changes in (
        {"command": ["swarmctl", "--cores", "2"]},
        {"made_with": {**manifest["made_with"], "code": "another"}},
    ):
        write_json(path, {**manifest, **changes})
        assert measured_cost(folder) is calibration, changes


def test_without_runs_there_is_a_calibration(
    duo: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(cost, "_CALIBRATION", duo)
    found = measured_cost(tmp_path)
    assert found.basis.startswith("a calibration")
    assert found.run_seconds("aggregation", 10, 120.0) > 0.0
