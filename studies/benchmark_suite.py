"""The benchmark suite over twenty seeds: `python -m studies.benchmark_suite`.

Prints the tables of docs/benchmark_suite.md, of the patterns of each task and of robots that stand,
and draws the picture of the tasks. The same command resumes. The runs are those of
`swarmctl exp bench`.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from benchmarks.table import markdown
from studies import keeper, kept, stand
from swarmd.sim.experiments.benchmark import HEADER, row, standings
from swarmd.sim.experiments.simulate import simulate
from swarmd.sim.lockstep.lockstep import simulate_run
from swarmd.sim.plots import scene
from swarmd.sim.plots.theme import new_figure, save
from swarmd.sim.scenarios.scenariofile import load_scenario, task_names

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from swarmd.sim.experiments.executor import Executor
    from swarmd.sim.experiments.results import Results
    from swarmd.sim.scenarios.scenario import Scenario
    from swarmd.sim.trace import Trace

STAND = "stand"
"""The control: the pattern of studies/stand.py."""
_DRAWN = ("floor", "light")
_NEST_COLOUR, _SOURCE_COLOUR, _DARK_FLOOR = "#4C72B0", "#55A868", "0.6"
_ROBOTS = ("robot that runs the pattern", "other robot")
_COLUMNS = 5
_SCALE = 0.42  # inches of 1 m
_TITLE = 0.6  # m above the arenas
_KEY = 0.42  # inches
BAR = "1 m"
"""The gid of the bar that is 1 m long."""


def main() -> None:
    """Do all runs, print the tables, and draw the picture."""
    options = kept.chosen("benchmark_suite", __doc__, takes_executor=True)
    with kept.executor_on(options.on) as executor:
        _measure(options.seeds, options.jobs, executor)


def _measure(seeds: int, jobs: int, executor: Executor | None) -> None:
    folder = keeper.experiment_folder("benchmark_suite")
    save(figure_of(task_names()), kept.FIGURES / "benchmark_suite.png")
    kept.print_parts(
        {
            part: table(
                results_of(
                    task,
                    range(seeds),
                    patterns,
                    folder / f"{seeds}-{part}",
                    jobs,
                    executor,
                )
                for task in task_names()
            )
            for part, patterns in (("benchmark_suite", ()), ("benchmark_stand", (STAND,)))
        }
    )


def results_of(
    task: str,
    seeds: Sequence[int],
    patterns: Sequence[str],
    folder: Path,
    jobs: int,
    executor: Executor | None = None,
) -> Results:
    """The runs of a task with these patterns, or those of its file, as `swarmctl exp bench`."""
    effective = load_scenario(task).effective
    return simulate(
        task,
        seeds,
        set={"plugin_dir": str(Path(stand.__file__).parent)} if STAND in patterns else None,
        sweep={"pattern": list(patterns or effective["patterns"])},
        jobs=jobs,
        executor=executor,
        out=folder / Path(task).stem,
        traces=False,
        metrics=[effective["metric"]],
        on_progress=kept.on_progress(task),
    )


def table(found: Iterable[Results]) -> str:
    """Markdown: a row for each pattern of the results of each task, best first."""
    rows = [[head.lower() if head.isupper() else head for head in HEADER]]
    for results in found:
        for task, rank, pattern, *cells in (row(one, "z.2f") for one in standings(results)):
            rows.append([f"`{task}`", rank, f"`{pattern}`", *cells])
    return markdown(rows)


def figure_of(tasks: Sequence[str]) -> Figure:
    """The tasks from above at the start of seed 0: all arenas to one scale, above a key."""
    scenarios = [load_scenario(name, {"duration": 0.4}) for name in tasks]
    traces = [simulate_run(scenario, 0) for scenario in scenarios]
    extents = [scene.extent_of(trace) for trace in traces]
    width = max(extent.width for extent in extents)
    height = max(extent.height for extent in extents)
    shown = scene.Extent(-width / 2.0, width / 2.0, -height / 2.0, height / 2.0 + _TITLE)
    columns = min(len(tasks), _COLUMNS)
    lines = math.ceil(len(tasks) / columns)
    figure = new_figure(_SCALE * width * columns, _SCALE * shown.height * lines + _KEY, is_map=True)
    grid = figure.subplots(lines, columns, squeeze=False).flat
    for axes, scenario, trace, extent in zip(grid, scenarios, traces, extents, strict=True):
        scene.prepare(axes, shown)
        axes.set_axis_off()
        axes.text(0.0, extent.top + 0.1, scenario.name, fontsize=9, ha="center")
        _paint_task(axes, scenario, trace, extent)
    axes.plot([shown.right - 1.0, shown.right], [shown.bottom] * 2, color="0.1", gid=BAR)
    axes.text(shown.right - 0.5, shown.bottom, "1 m", fontsize=9, ha="center", va="bottom")
    _paint_key(figure)
    return figure


def _paint_task(axes: Axes, scenario: Scenario, trace: Trace, extent: scene.Extent) -> None:
    from matplotlib.patches import Circle

    fields = [field for field in scenario.fields if field.__struct_config__.tag in _DRAWN]
    scene.paint_fields(axes, trace, extent, fields, is_small=True)
    scene.paint_arena(axes, trace)
    for kind in scenario.items:
        for disc, colour in ((kind.source, _SOURCE_COLOUR), (kind.nest, _NEST_COLOUR)):
            if disc is not None:
                axes.add_patch(Circle(disc[:2], disc[2], fill=False, edgecolor=colour))
    scene.paint_movable_boxes(axes, trace)
    groups = scenario.effective["groups"]
    others = {r for name, of in scenario.groups.items() if groups[name]["pattern"] for r in of}
    colours = [scene.robot_colour(1 if robot in others else 0) for robot in trace.ids]
    scene.paint_bodies(axes, trace, 0, colours, is_filled=True)


def _paint_key(figure: Figure) -> None:
    """What colours and lines are, below the arenas."""
    from matplotlib.lines import Line2D
    from matplotlib.patches import Patch

    rings = [
        Line2D(
            [], [], marker="o", markersize=9, linestyle="", fillstyle="none", color=c, label=text
        )
        for c, text in ((_NEST_COLOUR, "nest"), (_SOURCE_COLOUR, "source of items"))
    ]
    handles = [
        *(Patch(color=scene.robot_colour(k), label=_ROBOTS[k]) for k in range(2)),
        *rings,
        Patch(color=scene.MOVABLE_BOX_COLOUR, label="box or item that moves"),
        Patch(color=_DARK_FLOOR, label="dark floor"),
        Line2D([], [], color="0.45", linewidth=0.8, label="lines of equal light"),
    ]
    figure.legend(handles=handles, loc="outside lower center", ncols=7, frameon=False, fontsize=9)


if __name__ == "__main__":
    main()
