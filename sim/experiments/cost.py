"""The wall time of runs on this machine, from recorded runs or from a short calibration."""

from __future__ import annotations

import time
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from swarmd.core.errors import SwarmError
from swarmd.sim.experiments.manifest import read_manifest
from swarmd.sim.experiments.pool import Job, run_job
from swarmd.sim.experiments.provenance import made_with
from swarmd.sim.experiments.store import read_table
from swarmd.sim.scenarios.scenariofile import load_scenario

_CALIBRATION = "aggregation"
_SECONDS = 2.0  # simulated
_NEWEST = 20  # folders that are read


@dataclass(frozen=True, slots=True)
class Cost:
    """Wall time in s of one robot-second, one simulated second of one robot."""

    usual: float  # of scenarios that are not in `of`
    of: dict[str, float]  # by name of the scenario
    basis: str  # what was measured, in words

    def run_seconds(self, scenario: str, robots: int, duration: float) -> float:
        """The expected wall time in s of one run."""
        return self.of.get(scenario, self.usual) * robots * duration


def measured_cost(folder: Path) -> Cost:
    """The wall time per robot-second on one core here: medians of recorded runs in `folder`.

    Only the newest experiments are read. Experiments made with other software, on another
    processor or with `--cores` are left out, since their times do not hold for one core of this
    machine. Without any recorded run, a short simulation measures the cost.
    """
    software = made_with()
    costs_of: dict[str, list[float]] = {}  # s of wall time per robot-second of runs, by scenario
    manifests = sorted(folder.glob("*/manifest.json"), key=lambda path: -path.stat().st_mtime)
    for path in manifests[:_NEWEST]:
        try:
            manifest = read_manifest(path.parent)
            if manifest.made_with != software or "--cores" in manifest.command:
                continue
            plan = manifest.plan
            _, rows = read_table(path.parent, plan)  # by run id
        except SwarmError:  # a damaged folder, or a folder of another version
            continue
        costs = [row.wall / row.run.robot_seconds for row in rows.values()]
        costs_of.setdefault(plan.scenario, []).extend(costs)
    medians = {name: float(np.median(costs)) for name, costs in costs_of.items() if costs}
    if not medians:
        return _calibrated()
    all_costs = [cost for costs in costs_of.values() for cost in costs]
    usual = float(np.median(all_costs))
    basis = f"{len(all_costs)} recorded runs in {folder}/: {_shown(usual)}"
    return Cost(usual, medians, basis)


def _calibrated() -> Cost:
    scenario = load_scenario(_CALIBRATION, {"duration": _SECONDS})
    run_job(Job("warm", load_scenario(_CALIBRATION, {"duration": 0.1}).effective, 0, None))
    begin = time.perf_counter()
    result = run_job(Job("calibration", scenario.effective, 0, None))
    if result.metrics is None:
        raise SwarmError(f"the calibration failed: {result.reason}")
    usual = (time.perf_counter() - begin) / (len(scenario.robots) * _SECONDS)
    what = f"{len(scenario.robots)} robots and {_SECONDS:g} s of {_CALIBRATION}"
    return Cost(usual, {}, f"a calibration just now with {what}: {_shown(usual)}")


def _shown(cost: float) -> str:
    return f"{cost * 1e3:.2g} ms per robot and simulated second"
