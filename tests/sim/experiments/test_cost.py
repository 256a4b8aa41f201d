"""What a run costs is known from recorded runs of the same software, or from a calibration."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from swarmd.sim.experiments.cost import measured_cost
from swarmd.sim.experiments.manifest import write_json
from swarmd.sim.experiments.simulate import simulate


def test_recorded_runs_tell_the_cost(duo: Path, tmp_path: Path) -> None:
    folder = tmp_path / "experiments"
    simulate(duo, seeds=2, set={"duration": 1}, out=folder / "duo-1")
    table = folder / "duo-1" / "runs.csv"
    head, *rows = table.read_text().splitlines()
    first, second = (row.rpartition(",")[0] for row in rows)
    table.write_text(f"{head}\n{first},3.000\n{second},5.000\n")
    (folder / "damaged").mkdir()
    (folder / "damaged" / "manifest.json").write_text("{}")
    cost = measured_cost(folder)
    assert cost.basis.startswith(f"2 recorded runs in {folder}/")
    # The median of 3 and 5 s, for two robots and one second.
    assert cost.run_seconds(str(duo), 2, 1.0) == pytest.approx(4.0)
    assert cost.run_seconds("another", 4, 10.0) == pytest.approx(80.0)


@pytest.mark.parametrize("option", ["--cores", "--scheduler"])
def test_runs_with_several_cores_or_elsewhere_are_no_basis(
    duo: Path, tmp_path: Path, option: str
) -> None:
    simulate(duo, seeds=1, set={"duration": 0.1}, out=tmp_path / "duo-1")
    path = tmp_path / "duo-1" / "manifest.json"
    write_json(path, {**json.loads(path.read_text()), "command": ["swarmctl", option, "2"]})
    assert measured_cost(tmp_path).basis.startswith("a calibration")


def test_without_runs_of_this_software_there_is_a_calibration(duo: Path, tmp_path: Path) -> None:
    simulate(duo, seeds=1, set={"duration": 0.1}, out=tmp_path / "duo-1")
    path = tmp_path / "duo-1" / "manifest.json"
    manifest = json.loads(path.read_text())
    manifest["made_with"]["code"] = "another"
    write_json(path, manifest)
    cost = measured_cost(tmp_path)
    assert cost.basis.startswith("a calibration")
    assert cost.run_seconds("aggregation", 10, 120.0) > 0.0
