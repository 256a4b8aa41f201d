"""What the missions that come with swarmd bring about: `python -m studies.missions`.

Prints the tables of docs/missions.md. The same command resumes.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from benchmarks.table import markdown
from studies import keeper, kept
from studies.benchmark_suite import results_of, table
from swarmd.core.values import Array
from swarmd.sim.experiments.results import Results
from swarmd.sim.experiments.simulate import simulate
from swarmd.sim.trace import Trace

if TYPE_CHECKING:
    from swarmd.sim.experiments.executor import Executor

SPOT = "benchmark/aggregation_on_spot"
SEARCH, PATROL, FORAGE = MISSIONS = (
    "search_gather_decide_disperse",
    "patrol_without_leader",
    "forage_at_voted_source",
)


def patrolling(trace: Trace) -> float:
    """The share of the present robots that patrol at the end: those that report a target."""
    is_present = np.isfinite(trace.pose[-1, :, 0])
    return float(np.isfinite(trace.report["target"][-1])[is_present].mean())


def is_lost(trace: Trace) -> bool:
    """Whether a robot reports the loss of its leader."""
    return bool((trace.words["lost"] != "").any())


def count(values: Array) -> str:
    """The number of true values of all."""
    return f"{int(values.sum())} of {len(values)} runs"


def rows_of(mission: str, results: Results) -> list[tuple[str, str]]:
    """What was measured, and its value over the runs."""
    traces = [*results.traces]
    touches = results.metric("robot_contacts") + results.metric("arena_contacts")
    if mission == SEARCH:
        nearest, opinions = (
            results.metric(name) for name in ("nearest_neighbor_median_late", "consensus_opinion")
        )
        found = [
            ("consensus", count(results.metric("consensus_share") == 1.0)),
            ("consensus after [s]", kept.mean_of(results.metric("consensus_time"))),
            *(
                (f"late distance to the nearest, vote for {wanted} m [m]",
                 kept.mean_of(nearest[opinions == opinion]))
                for opinion, wanted in enumerate((0.7, 1.0, 1.3))
            ),
        ]  # fmt: skip
    elif mission == PATROL:
        found = [
            ("the loss of the leader is reported", count(np.array([*map(is_lost, traces)]))),
            (
                "robots that patrol at the end, share",
                kept.mean_of(np.array([*map(patrolling, traces)])),
            ),
        ]
    else:
        found = [("items a robot and minute", kept.mean_of(results.metric("items_delivered")))]
    return [*found, ("touches, all runs", str(int(touches.sum())))]


def main() -> None:
    """Do all runs, and print the tables."""
    options = kept.chosen("missions", __doc__, takes_executor=True)
    with kept.executor_on(options.on) as executor:
        _measure(options.seeds, options.jobs, executor)


def _measure(seeds: int, jobs: int, executor: Executor | None) -> None:
    folder = keeper.experiment_folder("missions")
    rows = [("mission", "measured", "mean (95 %), or runs")]
    for mission in MISSIONS:
        results = simulate(
            mission,
            seeds,
            jobs=jobs,
            executor=executor,
            out=folder / f"{seeds}-{mission}",
            on_progress=kept.on_progress(mission),
        )
        rows += [(f"`{mission}`", *cells) for cells in rows_of(mission, results)]
    patterns = "gather_on_dark_floor", "random_walk"
    spot = results_of(SPOT, range(seeds), patterns, folder / str(seeds), jobs, executor)
    kept.print_parts({"missions": markdown(rows), "mission_on_spot": table([spot])})


if __name__ == "__main__":
    main()
