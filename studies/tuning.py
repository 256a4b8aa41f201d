"""Attraction and dispersion tuned, with held-out seeds: `python -m studies.tuning`.

Attraction is tuned for the least late distance to the centroid (the metric of docs/paper.md,
experiment 1), dispersion for the shortest way to its distance, as by `swarmctl exp tune`. Prints
the tables of both pages. The same command resumes.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from benchmarks.table import markdown
from studies import keeper, kept, stand
from swarmd.sim.experiments.executor import Executor, on_executor
from swarmd.sim.experiments.results import Results, load_results
from swarmd.sim.experiments.simulate import simulate
from swarmd.sim.experiments.statistics import interval, number
from swarmd.sim.experiments.tune import HELD_OUT, PRESENT, TUNED, Tuning, tune

_NEAREST = {"late distance to the nearest [m]": "nearest_neighbor_median_late"}
SEARCHES: Mapping[str, tuple[str, Mapping[str, str], Mapping[str, Any]]] = {
    "tuned_attraction": (
        "all",
        {
            "late distance to the centroid [m]": "mean_distance_to_centroid_late",
            "late speed / limit": "mean_speed_late_share",
            "half distance after [s]": "gather_time",
            **_NEAREST,
        },
        {
            "scenario": "paper_exp1_burger",
            "metric": "mean_distance_to_centroid_late:min",
            "param": ("slack=0..0.2", "brake=0.1..1.5", "range=1..7"),
            "set": {"duration": 60},
        },
    ),
    "tuned_dispersion": (
        "tb3",
        {"mean way [m]": "path_length", **_NEAREST},
        {
            "scenario": "dispersion",
            "metric": "path_length:min",
            "param": ("ramp=0.05..1.5", "speed=0.05..0.22"),
            "set": {"groups.tb3.count": 5, "duration": 40},
        },
    ),
}
"""By the part of a page: the group of robots, the metrics of its table, and what is tuned."""


def main() -> None:
    """Do both searches, and print their tables."""
    options = kept.chosen("tuning", __doc__, takes_executor=True)
    with kept.executor_on(options.on) as executor:
        _measure(options, executor)


def _measure(options: argparse.Namespace, executor: Executor | None) -> None:
    folder = keeper.experiment_folder("tuning")
    parts = {}
    for name, (group, shown, search) in SEARCHES.items():
        found = tune(
            **search,
            # With 20 seeds: 64 runs over 8 seeds, and 50 held-out seeds.
            budget=max(4, 64 * options.seeds // kept.SEEDS),
            seeds=max(2, 8 * options.seeds // kept.SEEDS),
            held_out=50 * options.seeds // kept.SEEDS,
            candidates=5,
            jobs=options.jobs,
            runner=None if executor is None else on_executor(executor),
            out=folder / f"{options.seeds}-{name}",
            on_step=lambda line: print(line, file=sys.stderr, flush=True),
        )
        still = {"plugin_dir": str(Path(stand.__file__).parent), f"groups.{group}.pattern": "stand"}
        control = simulate(
            search["scenario"],
            found.held_out,
            set={**search["set"], **still},
            jobs=options.jobs,
            executor=executor,
            out=folder / f"{options.seeds}-{name}-still",
        )
        parts[name] = part_of(shown, found, control)
    kept.print_parts(parts)


def part_of(shown: Mapping[str, str], found: Tuning, control: Results) -> str:
    """The table of present, tuned and standing robots on held-out seeds, and the difference."""
    effort = f"{found.runs} runs over seeds {found.seeds[0]} to {found.seeds[-1]}"
    if found.gain is None:
        return f"No values of {effort} are better than the default."
    held_out = load_results(found.folder / HELD_OUT)
    values = ", ".join(f"`{name}: {value:.3g}`" for name, value in found.best.values.items())
    rows = [["", *shown, "touches"]]
    for text, results, variant in (
        ("default", held_out, f"candidate={PRESENT}"),
        (values, held_out, f"candidate={TUNED}"),
        ("robots that never move", control, ""),
    ):
        touches = results.metric("robot_contacts", variant) + results.metric(
            "arena_contacts", variant
        )
        cells = [kept.mean_of(results.metric(metric, variant)) for metric in shown.values()]
        rows.append([text, *cells, str(int(touches.sum()))])
    gain, held = found.gain, found.held_out
    return (
        f"{markdown(rows)}\n\nOf {effort}. The table has means over the held-out seeds {held[0]} to"
        f" {held[-1]}. Tuned less default, in the first column: {number(gain.difference)}"
        f" (95 % interval {interval(gain.interval)}, p {number(gain.p)})."
    )


if __name__ == "__main__":
    main()
