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
    """The cost of the newest experiments in `folder`; without any, a short simulation measures it.

    Left out are experiments made with other software, on another processor, with `--cores` or on a
    cluster.
    """
    software = made_with()
    costs_of: dict[str, list[float]] = {}
    places = sorted(folder.glob("*/manifest.json"), key=lambda path: -path.stat().st_mtime)
    for place in places[:_NEWEST]:
        try:
            manifest = read_manifest(place.parent)
            # A run's time with several cores, or on another machine, is not that of one core here.
            is_other = {"--cores", "--scheduler"} & {*manifest.command}
            if manifest.made_with != software or is_other:
                continue
            plan = manifest.plan
            rows = read_table(place.parent, plan)[1].values()
        except SwarmError:  # damaged or of another version: no basis
            continue
        costs = [row.wall / row.run.robot_seconds for row in rows]
        costs_of.setdefault(plan.scenario, []).extend(costs)
    costs_of = {name: costs for name, costs in costs_of.items() if costs}
    if not costs_of:
        return _calibrated()
    every = [cost for costs in costs_of.values() for cost in costs]
    usual = float(np.median(every))
    basis = f"{len(every)} recorded runs in {folder}/: {_shown(usual)}"
    return Cost(usual, {name: float(np.median(costs)) for name, costs in costs_of.items()}, basis)


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
