"""A scene of the ledger simulated in the worker that this process keeps."""

from __future__ import annotations

from collections.abc import Mapping
from contextlib import closing
from pathlib import Path
from typing import Any

from studies.behaviour.scenes import SCENES, SEED, Scene
from swarmd.core.errors import SwarmError
from swarmd.sim.experiments.pool import Job, JobResult, run_jobs
from swarmd.sim.scenarios.scenario import Scenario
from swarmd.sim.scenarios.scenariofile import load_scenario, scenario_of
from swarmd.sim.trace import Trace, load_trace


def scenario_of_scene(scene: Scene, more: Mapping[str, Any] | None = None) -> Scenario:
    """The scenario of a scene; `more`: further overrides of a scenario that has a name."""
    if isinstance(scene.scenario, str):
        return load_scenario(scene.scenario, {**scene.set, **(more or {})})
    return scenario_of(scene.scenario)


def simulated_scene(
    name: str, folder: Path, seconds: float | None = None, more: Mapping[str, Any] | None = None
) -> Trace:
    """The trace of a scene, made by a pinned worker in `folder`; SwarmError if the run fails.

    `seconds`: the first ones alone. `more`: as of `scenario_of_scene`.
    """
    scene = SCENES[name]
    effective = scenario_of_scene(scene, more).effective
    path = folder / "trace.npz"
    job = Job(name, effective, SEED, path, seconds=seconds or scene.seconds)
    with closing(run_jobs([job], 1)) as reports:
        (result,) = (report for report in reports if isinstance(report, JobResult))
    if result.reason or result.write_error:
        raise SwarmError(f"{name}: {result.reason or result.write_error}")
    return load_trace(path)
