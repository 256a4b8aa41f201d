"""Experiment 1 of Kaiser et al., ICRA 2022: `python -m studies.paper [OUT]`, or `make paper`.

Experiment 2 is `python -m studies.paper exp2 [OUT]`.

Runs every scenario with two laws of attraction, the original equations (`paper`) and ours
(`settling`), under our protection (the barrier) and with both visibilities of robots to lidars.
Runs the original equations also under the original protection, as published. Writes the tables and
figures of docs/paper.md to OUT. Runs that OUT already holds are not repeated. `--draw` runs nothing
and draws the runs in OUT.
"""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from benchmarks.table import markdown
from studies import paper_exp2
from studies.paper_exp2 import out_of, results_of
from swarmd.core.errors import SwarmError
from swarmd.core.values import Array
from swarmd.sim.experiments.compare import Side
from swarmd.sim.experiments.results import Results
from swarmd.sim.experiments.statistics import median_interval, summarize, wilson
from swarmd.sim.metrics import aggregation
from swarmd.sim.plots.figures import Look, compared_over_time
from swarmd.sim.plots.select import typical_first
from swarmd.sim.plots.theme import save
from swarmd.sim.plots.trajectories import trajectories_figure
from swarmd.sim.trace import Trace

SCENARIOS = ("burger", "waffle_pi", "jackal", "hardware")
TURTLEBOTS = SCENARIOS[:2]
VISIBILITIES = ("body", "real")
ORIGINAL = "original"
"""Law `paper` under protection mode `potential_field`."""
DRAWN = ("settling", ORIGINAL)

SEEDS = range(20)
FRESH = range(500, 520)
"""Seeds with which no parameter was chosen."""

PLAN = (
    ("settling", SEEDS, TURTLEBOTS),
    ("paper", SEEDS, TURTLEBOTS),
    ("settling", SEEDS, SCENARIOS[2:]),
    ("settling", FRESH, TURTLEBOTS),
    ("paper", SEEDS, SCENARIOS[2:]),
    ("settling", FRESH, SCENARIOS[2:]),
    (ORIGINAL, SEEDS, SCENARIOS),
)
MDC_SOON = 0.86
MDC_LATE = {"burger": 0.65, "waffle_pi": 0.75}
"""Upper bounds in m of the mean distance to the centroid after 30 s and at the end."""

Column = tuple[str, Callable[[Results, str, str], str]]


def changes(name: str, law: str) -> Mapping[str, str]:
    """The overrides that select a law."""
    if law != ORIGINAL:
        return {"groups.all.parameters.law": law}
    platform = "waffle_pi" if name == "hardware" else name
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
    """The median of `values` (n,) as a text, with its interval."""
    around = median_interval(values)
    text = f"{np.median(values):.2f}"
    return f"{text} ({around.low:.2f}-{around.high:.2f})" if around else text


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
    values = results.metric(f"mean_distance_to_centroid_{when}", variant)
    return share(values <= bound) if name in TURTLEBOTS else "-"


def _contacts(results: Results, variant: str, _: str) -> str:
    values = results.metric("robot_contacts", variant) + results.metric("arena_contacts", variant)
    return f"{int(values.sum())} in {np.count_nonzero(values)}"


CLUSTER: tuple[Column, ...] = (
    ("one cluster at end", _share("one_cluster_at_end", lambda v: v == 1.0)),
    ("for 90 % of last 60 s", _share("time_in_one_cluster_late", lambda v: v >= 0.9)),
    ("MDC at 30 s [m]", _median("mean_distance_to_centroid_30s")),
    ("<= 0.86", lambda r, v, n: _met(r, v, n, "30s", MDC_SOON)),
    ("late MDC [m]", _median("mean_distance_to_centroid_late")),
    ("within bound", lambda r, v, n: _met(r, v, n, "late", MDC_LATE.get(n, 0.0))),
)
BEHAVIOUR: tuple[Column, ...] = (
    ("contacts", _contacts),
    ("late speed / v_max", _median("mean_speed_late_share")),
    ("late protection duty", _median("protection_duty_late")),
    ("nearest neighbour [m]", _median("nearest_neighbor_median_late")),
    ("half MDC after [s]", lambda r, v, n: _gather_time(r.metric("gather_time", v))),
)


def _gather_time(values: Array) -> str:
    """The median of all runs; "-" if at least half of them never gathered."""
    never = int(np.isnan(values).sum())
    if not never:
        return median(values)
    middle = summarize(values, is_time_to_event=True).median
    return f"{'-' if middle is None else f'{middle:.2f}'}, {never} never"


def groups_of_three(trace: Trace, link: float, by: float = 10.0) -> bool:
    """Whether before `by` s all but one robot are in groups of three or more."""
    labels = aggregation.clusters(trace, link)[trace.t - trace.t[0] <= by + 1e-9]
    sizes = (labels[:, :, None] == labels[:, None, :]).sum(axis=2)
    return bool(((sizes >= 3).sum(axis=1) >= len(trace.ids) - 1).any())


def hardware_rows(results: Results) -> Iterator[tuple[str, list[str]]]:
    """Rows of the table that checks the paper's statements on its hardware experiment.

    Robots within a link of 1.0 m or 0.8 m of each other are in one group.
    """
    for visibility in VISIBILITIES:
        variant = variant_of(visibility)
        runs = [run for run in results.runs if run.variant.name == variant]
        traces = [results.traces[run.id] for run in runs]
        for link in (1.0, 0.8):
            most = [(trace, aggregation.largest_cluster(trace, link)) for trace in traces]
            after = [size[trace.t - trace.t[0] > 10.0].max() for trace, size in most]
            late = [size[trace.t >= trace.t[-1] - 60.0].mean() for trace, size in most]
            yield (
                f"{visibility}, {link:g} m",
                [
                    share(np.array([groups_of_three(trace, link) for trace in traces])),
                    share(np.array(after) >= 6),
                    share(np.array([size[-1] >= 6 for _, size in most])),
                    median(np.array(late)),
                    _contacts(results, variant, ""),
                ],
            )


HARDWARE = ("", "groups of three by 10 s", "six together after 10 s", "at most one lost at 120 s",
            "late largest group", "contacts")  # fmt: skip


def tables(by_run: Mapping[tuple[str, str, bool], Results]) -> str:
    """All tables, of the runs that exist."""
    parts = []
    for title, columns, names in (
        ("Gathering", CLUSTER, SCENARIOS[:3]),
        ("Contacts, rest and time", BEHAVIOUR, SCENARIOS),
    ):
        rows = [
            [f"{name}, {visibility}, {law}{', fresh' if is_fresh else ''}"]
            + [cell(results, variant_of(visibility), name) for _, cell in columns]
            for (name, law, is_fresh), results in by_run.items()
            if name in names
            for visibility in VISIBILITIES
            if results.seeds(variant_of(visibility))
        ]
        parts += [f"## {title}", markdown([["", *(head for head, _ in columns)], *rows])]
    rows = [
        [f"{row}, {law}{', fresh' if is_fresh else ''}", *cells]
        for (name, law, is_fresh), results in by_run.items()
        if name == "hardware"
        for row, cells in hardware_rows(results)
    ]
    return "\n\n".join([*parts, "## Hardware", markdown([HARDWARE, *rows])]) + "\n"


def draw(by_run: Mapping[tuple[str, str, bool], Results], out: Path) -> None:
    """The figures: the distance to the centroid over time, and a typical run of each law."""
    out.mkdir(parents=True, exist_ok=True)
    metric = "mean_distance_to_centroid_late"
    for name in TURTLEBOTS:
        sides = {
            f"{law}, {visibility}": Side(law, by_run[name, law, False], variant_of(visibility))
            for law in DRAWN
            if (name, law, False) in by_run
            for visibility in VISIBILITIES
        }
        if sides:
            look = Look(targets={metric: MDC_LATE[name]})
            figure = compared_over_time(sides, metric, look, f"paper_exp1_{name}")
            save(figure, out / f"paper_{name}_mdc.png")
    for law in DRAWN:
        results = by_run.get(("waffle_pi", law, False))
        if results is not None:
            variant = variant_of("real")
            values = results.metric(metric, variant)
            runs = [run for run in results.runs if run.variant.name == variant]
            run = runs[typical_first(values)[0]]
            title = f"law {law}, real visibility, seed {run.seed}"
            figure = trajectories_figure(results.traces[run.id], title)
            save(figure, out / f"paper_waffle_pi_{law}.png")


def main(arguments: Sequence[str]) -> None:
    """Do all runs, the most important first, then write tables and figures."""
    out, is_drawing = out_of(arguments, "build/paper")
    by_run: dict[tuple[str, str, bool], Results] = {}
    for law, seeds, names in PLAN:
        for name in names:
            results = results_of(
                out / f"{name}-{law}{'-fresh' if seeds is FRESH else ''}",
                is_drawing,
                f"paper_exp1_{name}",
                seeds,
                set=changes(name, law),
                sweep={"lidar_visibility": list(VISIBILITIES)},
            )
            if results:
                by_run[name, law, seeds is FRESH] = results
    (out / "tables.md").write_text(tables(by_run))
    draw(by_run, out / "figures")


if __name__ == "__main__":
    unknown = [word for word in sys.argv[1:] if word.startswith("-") and word != "--draw"]
    try:
        if unknown:  # such as --help
            print(__doc__)
        elif sys.argv[1:2] == ["exp2"]:
            paper_exp2.main(sys.argv[2:])
        else:
            main(sys.argv[1:])
    except SwarmError as error:
        raise SystemExit(f"error: {error}") from error
