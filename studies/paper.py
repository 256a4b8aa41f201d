"""Experiment 1 of Kaiser et al., ICRA 2022: `python -m studies.paper`.

Experiment 2 is `python -m studies.paper_exp2`; `make night ARGS="paper paper_exp2"` does both.

Runs every scenario with two laws of attraction, the original equations (`paper`) and ours
(`settling`), under our protection (the barrier) and with both visibilities of robots to lidars.
Runs the original equations also under the original protection, as published. The control in
every table is the same run with robots that do not move (`still`). Prints the tables of
docs/paper.md. With all seeds it also draws the figures of that page. The same command resumes.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping

import numpy as np
from numpy.typing import NDArray

from benchmarks.table import markdown
from studies import ideal_search, keeper, kept
from swarmd.core.pin import restart_pinned
from swarmd.core.values import Array
from swarmd.sim.experiments.compare import Side
from swarmd.sim.experiments.results import Results
from swarmd.sim.experiments.simulate import simulate
from swarmd.sim.experiments.statistics import median_interval, summarize, wilson
from swarmd.sim.metrics import aggregation, window
from swarmd.sim.plots.figures import Look, compared_over_time
from swarmd.sim.plots.select import typical_first
from swarmd.sim.plots.theme import save
from swarmd.sim.plots.trajectories import trajectories_figure
from swarmd.sim.trace import Trace

TURTLEBOTS = ("burger", "waffle_pi")
GATHERING = (*TURTLEBOTS, "jackal")
HARDWARE = ("hardware", "hardware_free")
SCENARIOS = {
    "burger": "paper_exp1_burger",
    "waffle_pi": "paper_exp1_waffle_pi",
    "jackal": "paper_exp1_jackal",
    "hardware": "paper_exp1_hardware",
    "hardware_free": "paper_exp1_hardware_free",
}
"""In full, since the words of this file name the files that decide the results."""
VISIBILITIES = ("body", "real")
ORIGINAL = "original"
"""Law `paper` under protection mode `potential_field`."""
STILL = "still"
"""Robots that do not move. Runs with visibility `real` would be the same, so there are none."""
DRAWN = ("settling", ORIGINAL)

SEEDS = range(20)
FRESH = range(500, 520)
"""Seeds with which no parameter was chosen."""
HARDWARE_SEEDS = range(8000, 8040)
"""Likewise, for both starts of the hardware experiment."""

PLAN = (
    ("settling", SEEDS, TURTLEBOTS),
    ("settling", HARDWARE_SEEDS, HARDWARE),
    ("paper", SEEDS, TURTLEBOTS),
    ("paper", HARDWARE_SEEDS, HARDWARE),
    (STILL, HARDWARE_SEEDS, HARDWARE),
    (STILL, SEEDS, GATHERING),
    ("settling", SEEDS, ("jackal",)),
    ("settling", FRESH, GATHERING),
    ("paper", SEEDS, ("jackal",)),
    (ORIGINAL, SEEDS, GATHERING),
    (ORIGINAL, HARDWARE_SEEDS, HARDWARE),
)
MDC = "mean_distance_to_centroid"
MDC_SOON = 0.86
MDC_LATE = {"burger": 0.65, "waffle_pi": 0.75}
"""Upper bounds in m of the mean distance to the centroid after 30 s and at the end."""
LINK = 1.0
"""m, between axle centres of linked robots."""
ENOUGH = 6
"""Robots of seven: the authors lost one."""

Runs = Mapping[tuple[str, str, bool], Results]
"""By scenario, law, and whether the seeds are FRESH."""
Column = tuple[str, Callable[[Results, str, str], str]]


def changes(name: str, law: str) -> Mapping[str, str | float]:
    """The overrides that select a law."""
    if law == STILL:
        return {"groups.all.parameters.speed": 0.0, "groups.all.parameters.turn": 0.0}
    if law != ORIGINAL:
        return {"groups.all.parameters.law": law}
    platform = "waffle_pi" if name in HARDWARE else name
    mode = {f"platforms.{platform}.protection.mode": "potential_field"}
    return {"groups.all.parameters.law": "paper", **mode}


def variant_of(visibility: str) -> str:
    """The name of a variant of these experiments."""
    return f"lidar_visibility={visibility}"


def share(values: NDArray[np.bool_]) -> str:
    """The share of true `values` (n,) as a text, with Wilson's interval."""
    count, n = int(values.sum()), len(values)
    around = wilson(count, n)
    return f"{count}/{n} ({around.low:.2f}-{around.high:.2f})"


def median(values: Array) -> str:
    """The median of `values` (n,) as a text, with its interval and the number of missing values."""
    known = values[~np.isnan(values)]
    if len(known) == 0:
        return "-"
    around = median_interval(known)
    text = f"{np.median(known):.2f}"
    text += f" ({around.low:.2f}-{around.high:.2f})" if around else ""
    return text if len(known) == len(values) else f"{text}, {len(values) - len(known)} without"


def is_progress(results: Results, variant: str) -> NDArray[np.bool_]:
    """(runs,) whether the mean distance to the centroid is not above that at the start."""
    start = results.metric(f"{MDC}_start", variant)
    progress: NDArray[np.bool_] = results.metric(f"{MDC}_end", variant) <= start
    return progress


def _median(metric: str) -> Callable[[Results, str, str], str]:
    return lambda results, variant, _: median(results.metric(metric, variant))


def _share(
    metric: str, is_met: Callable[[Array], NDArray[np.bool_]]
) -> Callable[[Results, str, str], str]:
    return lambda results, variant, _: share(is_met(results.metric(metric, variant)))


def _met(results: Results, variant: str, name: str, when: str, bound: float) -> str:
    """The share of runs within the bound; "-" except for TurtleBots.

    Jackals start too close to each other, and spread.
    """
    values = results.metric(f"{MDC}_{when}", variant)
    return share(values <= bound) if name in TURTLEBOTS else "-"


def _contacts(results: Results, variant: str, _: str) -> str:
    values = results.metric("robot_contacts", variant) + results.metric("arena_contacts", variant)
    return f"{int(values.sum())} in {np.count_nonzero(values)}"


PROGRESS: tuple[Column, ...] = (
    ("MDC at start [m]", _median(f"{MDC}_start")),
    ("at 120 s [m]", _median(f"{MDC}_end")),
    ("not above start", lambda r, v, _: share(is_progress(r, v))),
)


def _stopped(results: Results, variant: str, _: str) -> str:
    """The number of robots that do not run at the end, such as after invalid scans."""
    states = [trace.state for trace in traces_of(results, variant)]
    ends = np.array([state[-1] for state in states if state is not None])
    return f"{np.count_nonzero(ends != 'running')} of {ends.size}"


CLUSTER: tuple[Column, ...] = (
    ("one cluster at end", _share("one_cluster_at_end", lambda v: v == 1.0)),
    ("for 90 % of last 60 s", _share("time_in_one_cluster_late", lambda v: v >= 0.9)),
    *PROGRESS,
    ("MDC <= 0.86 at 30 s", lambda r, v, n: _met(r, v, n, "30s", MDC_SOON)),
    ("late MDC [m]", _median(f"{MDC}_late")),
    ("within bound", lambda r, v, n: _met(r, v, n, "late", MDC_LATE.get(n, 0.0))),
)
BEHAVIOUR: tuple[Column, ...] = (
    ("contacts", _contacts),
    ("stopped robots", _stopped),
    ("way of a robot [m]", _median("path_length")),
    ("late speed / v_max", _median("mean_speed_late_share")),
    ("late protection duty", _median("protection_duty_late")),
    ("nearest neighbour [m]", _median("nearest_neighbor_median_late")),
    ("half MDC after [s]", lambda r, v, _: _gather_time(r.metric("gather_time", v))),
)
TOGETHER: tuple[Column, ...] = (
    *PROGRESS,
    ("six linked at 120 s", lambda r, v, _: share(is_together(r, v))),
    ("both", lambda r, v, _: share(is_together(r, v) & is_progress(r, v))),
    ("late largest group", lambda r, v, _: median(late_largest_group(r, v))),
    ("way of a robot [m]", _median("path_length")),
    ("contacts", _contacts),
)
TABLES = (
    ("paper_gathering", CLUSTER, GATHERING),
    ("paper_contacts", BEHAVIOUR, (*GATHERING, *HARDWARE)),
    ("paper_hardware", TOGETHER, HARDWARE),
)


def _gather_time(values: Array) -> str:
    """The median of all runs; "-" if at least half of them never gathered."""
    never = int(np.isnan(values).sum())
    if not never:
        return median(values)
    middle = summarize(values, is_time_to_event=True).median
    return f"{'-' if middle is None else f'{middle:.2f}'}, {never} never"


def is_together(results: Results, variant: str) -> NDArray[np.bool_]:
    """(runs,) whether six robots or more are linked, within 1.0 m of the next, at the end."""
    together: NDArray[np.bool_] = results.metric("largest_cluster", variant) >= ENOUGH
    return together


def traces_of(results: Results, variant: str) -> list[Trace]:
    """The traces of the runs of a variant."""
    return [results.traces[run.id] for run in results.runs if run.variant.name == variant]


def late_largest_group(results: Results, variant: str) -> Array:
    """(runs,) the mean size of the largest group of linked robots in the last 60 s."""
    lates = [window.late(trace) for trace in traces_of(results, variant)]
    return np.array([aggregation.largest_cluster(trace, LINK).mean() for trace in lates])


def label(name: str, variant: str, law: str, is_fresh: bool) -> str:
    """The name of a row."""
    visibility = "" if law == STILL else f", {variant.partition('=')[2]}"
    return f"{name}{visibility}, {law}{', fresh' if is_fresh else ''}"


def tables(by_run: Runs) -> dict[str, str]:
    """All tables of runs, by the name of their part of the page."""
    parts = {}
    for part, columns, names in TABLES:
        rows = [
            [label(name, variant, law, is_fresh)]
            + [cell(results, variant, name) for _, cell in columns]
            for name in names
            for (scenario, law, is_fresh), results in by_run.items()
            if scenario == name
            for variant in results.variants
        ]
        parts[part] = markdown([["", *(head for head, _ in columns)], *rows])
    return parts


def searches() -> str:
    """The table of the ideal search."""
    rows = [["", "six together within 120 s", "median time [s]"]]
    for rule, most_moving in ideal_search.RULES.items():
        times = ideal_search.search_times(HARDWARE_SEEDS, most_moving)
        middle = np.median(times)
        text = f"{middle:.1f}" if np.isfinite(middle) else "-"
        rows.append([rule, share(np.isfinite(times)), text])
    return markdown(rows)


def draw(by_run: Runs) -> None:
    """The figures: the distance to the centroid over time, and a typical run of each law."""
    metric = f"{MDC}_late"
    for name in TURTLEBOTS:
        sides = {
            f"{law}, {visibility}": Side(law, by_run[name, law, False], variant_of(visibility))
            for law in DRAWN
            for visibility in VISIBILITIES
        }
        look = Look(targets={metric: MDC_LATE[name]})
        figure = compared_over_time(sides, metric, look, f"paper_exp1_{name}")
        save(figure, kept.FIGURES / f"paper_{name}_mdc.png")
    for law in DRAWN:
        results, variant = by_run["waffle_pi", law, False], variant_of("real")
        values = results.metric(metric, variant)
        runs = [run for run in results.runs if run.variant.name == variant]
        run = runs[typical_first(values)[0]]
        title = f"law {law}, real visibility, seed {run.seed}"
        figure = trajectories_figure(results.traces[run.id], title)
        save(figure, kept.FIGURES / f"paper_waffle_pi_{law}.png")


def main() -> None:
    """Do all runs, the most important first, print the tables and draw the figures."""
    options = kept.chosen("paper", __doc__, takes_executor=True)
    folder = keeper.experiment_folder("paper")
    with kept.executor_on(options.on) as executor:
        by_run = {
            (name, law, seeds is FRESH): simulate(
                SCENARIOS[name],
                seeds[: len(seeds) * options.seeds // kept.SEEDS],
                set=changes(name, law),
                sweep={"lidar_visibility": list(VISIBILITIES[: 1 if law == STILL else 2])},
                jobs=options.jobs,
                executor=executor,
                out=folder / f"{options.seeds}-{name}-{law}{'-fresh' * (seeds is FRESH)}",
                on_progress=kept.on_progress(f"{name}, {law}"),
            )
            for law, seeds, names in PLAN
            for name in names
        }
    if options.seeds == kept.SEEDS:
        draw(by_run)
    kept.print_parts({**tables(by_run), "paper_ideal_search": searches()})


if __name__ == "__main__":
    restart_pinned()  # as in a night, so that runs have its bits
    main()
