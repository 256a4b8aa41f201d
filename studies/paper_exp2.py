"""Experiment 2 of Kaiser et al., ICRA 2022: `python -m studies.paper_exp2`.

Seven Waffle Pis agree on a distance and disperse to this distance: in the paper's arena, in an
arena 1.4 times as long and wide, and with an eighth robot that joins late. Prints the tables of
docs/paper.md, section "Experiment 2". With all seeds it also draws the figures of that section. The
same command resumes.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from benchmarks.table import markdown
from studies import keeper, kept
from swarmd.patterns.discussed_dispersion.metrics import (
    TOLERANCE,
    Course,
    Joining,
    joined,
    judged,
)
from swarmd.sim.experiments.results import Results
from swarmd.sim.experiments.simulate import simulate
from swarmd.sim.metrics.lidar_ranges import lidar_ranges
from swarmd.sim.plots.bands import Series, series_figure
from swarmd.sim.plots.theme import save
from swarmd.sim.plots.trajectories import trajectories_figure

LARGER = (9.24, 6.72)
"""1.4 times the paper's arena along both sides."""

PLAN: tuple[tuple[str, str, Mapping[str, Any]], ...] = (
    ("paper", "paper_exp2", {}),
    ("larger", "paper_exp2", {"arena.size": list(LARGER), "groups.first.parameters.initial": 2}),
    ("late", "paper_exp2_late", {}),
)
TITLES = {"paper": "6.6 x 4.8 m", "larger": "9.24 x 6.72 m", "late": "one joins at 50 s"}


HEAD = ("", "runs", "all agree from 20 s on", "moved before 20 s [m]",
        "every range kept, 40 to 70 s", "kept since [s]", "least range, 40 to 70 s [m]",
        "standing", "strayed [m]", "contacts")  # fmt: skip


def row(courses: Sequence[Course]) -> list[str]:
    """The cells of one line of the table, for runs with one opinion, without its first cell."""
    n = len(courses)

    def count(flags: Sequence[bool]) -> str:
        return f"{sum(flags)}/{n}"

    def spread(values: Sequence[float], digits: int) -> str:
        some = sorted(values)
        return (
            f"{some[n // 2]:.{digits}f} ({some[0]:.{digits}f}-{some[-1]:.{digits}f})"
            if some[0] < np.inf
            else "-"
        )

    return [
        str(n),
        count([c.opinion >= 0 for c in courses]),
        f"{max(c.moved for c in courses):.3f}",
        count([c.is_kept for c in courses]),
        spread([c.kept_since for c in courses], 1),
        spread([c.least for c in courses], 2),
        count([c.is_standing for c in courses]),
        spread([c.strayed for c in courses], 3),
        str(sum(c.contacts for c in courses)),
    ]


def tables(results: Mapping[str, Results]) -> dict[str, str]:
    """Both tables, by the name of their part of the page."""
    rows: list[Sequence[str]] = [HEAD]
    for name in ("paper", "larger"):
        courses = [judged(trace) for trace in results[name].traces]
        for opinion in sorted({course.opinion for course in courses}):
            some = [course for course in courses if course.opinion == opinion]
            what = f"f({opinion}) = {some[0].wanted:.1f} m" if opinion >= 0 else "no agreement"
            rows.append((f"{TITLES[name]}, {what}", *row(some)))
    late = [joined(trace) for trace in results["late"].traces]
    return {"paper_exp2": markdown(rows), "paper_exp2_late": markdown(late_rows(late))}


def late_rows(found: Sequence[Joining]) -> list[tuple[str, str]]:
    """The rows of the table of runs in which a robot joins late."""
    n = len(found)
    adopted = sorted(one.adopted for one in found)
    stirred = [one.stirred for one in found]
    least = [one.least for one in found]
    return [
        ("of the runs with an eighth robot", ""),
        ("it adopts the opinion of the seven", f"{np.isfinite(adopted).sum()}/{n}"),
        ("after [s], median (most)", f"{adopted[n // 2]:.1f} ({adopted[-1]:.1f})"),
        ("one of the seven changes its opinion", f"{sum(one.is_swayed for one in found)}/{n}"),
        ("farthest way of one of the seven [m]", f"{min(stirred):.2f} to {max(stirred):.2f}"),
        (
            "every range kept in the last 20 s",
            f"{sum(one >= 1.0 - TOLERANCE for one in least)}/{n}",
        ),
        ("least range then [m]", f"{min(least):.2f} to {max(least):.2f}"),
        ("contacts", str(sum(one.contacts for one in found))),
    ]


def draw(results: Mapping[str, Results]) -> None:
    """The least range of each run over time, by opinion, and a typical run."""
    for name in ("paper", "larger"):
        groups: dict[str, list[Series]] = {}
        is_run_drawn = name != "paper"
        for trace in results[name].traces:
            course = judged(trace)
            label = f"opinion {course.opinion}: {course.wanted:.1f} m wanted"
            series = (trace.t - trace.t[0], lidar_ranges(trace).min(axis=1))
            groups.setdefault(label, []).append(series)
            if course.opinion == 1 and not is_run_drawn:
                figure = trajectories_figure(trace, "experiment 2, opinion 1: 1.0 m")
                is_run_drawn = bool(save(figure, kept.FIGURES / "paper_exp2_run.png"))
        title = f"experiment 2, {TITLES[name]}"
        ordered = {label: groups[label] for label in sorted(groups)}
        figure = series_figure({"": ordered}, label="least range of all", unit="m", title=title)
        save(figure, kept.FIGURES / f"paper_exp2_{name}.png")


def main() -> None:
    """Do all runs, print the tables and draw the figures."""
    options = kept.chosen("paper_exp2", __doc__, takes_executor=True)
    folder = keeper.experiment_folder("paper_exp2")
    with kept.executor_on(options.on) as executor:
        results = {
            name: simulate(
                scenario,
                options.seeds,
                set=changes,
                jobs=options.jobs,
                executor=executor,
                out=folder / f"{options.seeds}-{name}",
                on_progress=kept.on_progress(name),
            )
            for name, scenario, changes in PLAN
        }
    if options.seeds == kept.SEEDS:
        draw(results)
    kept.print_parts(tables(results))


if __name__ == "__main__":
    main()
