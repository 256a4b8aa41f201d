"""Experiment 2 of Kaiser et al., ICRA 2022: `python -m studies.paper_exp2`.

Seven Waffle Pis agree on a distance and disperse to this distance: in the paper's arena, in an
arena 1.4 times as long and wide, and with an eighth robot that joins late. Prints the tables of
docs/paper.md, section "Experiment 2". With all seeds it also draws the figures of that section. The
same command resumes.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from benchmarks.table import markdown
from studies import keeper, kept
from swarmd.core.values import Array
from swarmd.settings.settings import load_platform
from swarmd.sim.experiments.results import Results
from swarmd.sim.experiments.simulate import simulate
from swarmd.sim.plots.bands import Series, series_figure
from swarmd.sim.plots.theme import save
from swarmd.sim.plots.trajectories import trajectories_figure
from swarmd.sim.trace import Trace
from swarmd.sim.world.arena import parse_arena
from swarmd.sim.world.geometry import apart, transform

DISCUSS = 20.0
SPREAD_BY = 40.0
KEPT_FOR = 30.0
TOLERANCE = 0.03
"""Three standard deviations of the lidar's noise, in m."""
STRAYED = 0.1
"""Standing robots stay within this distance in m of a position."""
MOVING = 0.05
"""Standing robots move for at most this mean share of the time."""
STILL = 0.01
"""Slower than this speed in m/s is no motion."""
JOINED = 50.0
LARGER = (9.24, 6.72)
"""1.4 times the paper's arena along both sides."""

PLAN: tuple[tuple[str, str, Mapping[str, Any]], ...] = (
    ("paper", "paper_exp2", {}),
    ("larger", "paper_exp2", {"arena.size": list(LARGER), "groups.first.parameters.initial": 2}),
    ("late", "paper_exp2_late", {}),
)
TITLES = {"paper": "6.6 x 4.8 m", "larger": "9.24 x 6.72 m", "late": "one joins at 50 s"}


@dataclass(frozen=True, slots=True)
class Course:
    """The result of one run. Times in s from the start, lengths in m.

    A range is the true distance of a robot's lidar to the nearest robot or wall.
    """

    opinion: int
    """The opinion of all robots from 20 s on; -1 if they differ."""
    moved: float
    """The largest distance of a robot from its start before 20 s."""
    wanted: float
    """The wanted distance f(opinion)."""
    kept_since: float
    """The time from which until 70 s all ranges are at least `wanted` - TOLERANCE; inf: never."""
    least: float
    """The least range from 40 to 70 s."""
    strayed: float
    """The largest distance of a robot from its position at 40 s, from 40 to 70 s."""
    moving: float
    """The mean share of the time from 40 to 70 s in which a robot moves."""
    contacts: int
    """The number of contact steps of the run."""

    @property
    def is_kept(self) -> bool:
        """Whether all ranges were large enough from 40 s to 70 s."""
        return self.kept_since <= SPREAD_BY

    @property
    def is_standing(self) -> bool:
        """Whether the robots stood from 40 s to 70 s, except for small corrections."""
        return self.strayed <= STRAYED and self.moving <= MOVING


def judged(trace: Trace, base: float = 0.6, step: float = 0.4) -> Course:
    """The result of a trace of experiment 2; f(opinion) = `base` + `step` * opinion, in m.

    This f is the paper's function, not the distance that robots report.
    """
    time = trace.t - trace.t[0]
    opinion = trace.report["opinion"]
    since, until = time >= DISCUSS - 1e-6, time <= SPREAD_BY + KEPT_FOR + 1e-6
    late = (time >= SPREAD_BY - 1e-6) & until
    agreed = int(opinion[since][0, 0]) if len(np.unique(opinion[since])) == 1 else -1
    places = trace.pose[..., :2]
    least = ranges(trace).min(axis=1)
    wanted = base + step * float(agreed if agreed >= 0 else np.max(opinion[-1]))
    times = np.append(time[until], np.inf)
    too_near = np.flatnonzero(least[until] < wanted - TOLERANCE)
    kept_since = times[too_near[-1] + 1] if len(too_near) else 0.0
    speeds = np.hypot(*np.moveaxis(np.diff(places, axis=0), -1, 0)) / np.diff(trace.t)[:, None]
    return Course(
        opinion=agreed,
        moved=float(away(places[~since]).max()),
        wanted=wanted,
        kept_since=float(kept_since),
        least=float(least[late].min()),
        strayed=float(away(places[late]).max()),
        moving=float((speeds[late[1:]] > STILL).mean()),
        contacts=len(trace.contact_t),
    )


def away(places: Array) -> Array:
    """(T, n) the distance in m of positions (T, n, 2) from those at the first instant."""
    distance: Array = np.hypot(*np.moveaxis(places - places[0], -1, 0))
    return distance


def ranges(trace: Trace) -> Array:
    """(T, n) the true distance in m from each lidar to the nearest outline or wall."""
    arena = parse_arena(str(trace.meta["arena"]))
    half = np.array([arena.length, arena.width]) / 2.0
    offsets = {name: np.array([load_platform(name).scan.offset]) for name in trace.platforms}
    robots = range(len(trace.ids))
    lidars = [transform(offsets[trace.platforms[i]], trace.pose[:, i])[:, 0] for i in robots]
    outlines = [transform(trace.footprint(i), trace.pose[:, i]) for i in robots]
    nearest = np.stack([(half - np.abs(lidar)).min(axis=1) for lidar in lidars], axis=1)
    for i in robots:
        for j in robots:
            if i != j:
                start, end = outlines[j], np.roll(outlines[j], -1, axis=1)
                away = apart(lidars[i][:, None], start, end).min(axis=1)
                nearest[:, i] = np.minimum(nearest[:, i], away)
    return nearest


@dataclass(frozen=True, slots=True)
class Joining:
    """The result of a run in which an eighth robot joins late with another opinion."""

    adopted: float  # s until the eighth robot holds the opinion of the seven; inf: never
    is_swayed: bool  # one of the seven changes its opinion after the eighth has joined
    stirred: float  # m, the largest distance that one of the seven moves after that
    least: float  # m, the least range in the last 20 s
    contacts: int  # contact steps of the run


def joined(trace: Trace, at: float = JOINED) -> Joining:
    """The result of a trace of `paper_exp2_late`, in which the last robot joins at `at` s."""
    time, opinion = trace.t - trace.t[0], trace.report["opinion"]
    there = time >= at + 0.5
    others = opinion[there][:, :-1]
    held = np.flatnonzero(opinion[there][:, -1] == others[0, 0])
    return Joining(
        adopted=float(time[there][held[0]] - at) if len(held) else float("inf"),
        is_swayed=len(np.unique(others)) > 1,
        stirred=float(away(trace.pose[there][:, :-1, :2]).max()),
        least=float(ranges(trace)[time >= time[-1] - 20.0].min()),
        contacts=len(trace.contact_t),
    )


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
            series = (trace.t - trace.t[0], ranges(trace).min(axis=1))
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
