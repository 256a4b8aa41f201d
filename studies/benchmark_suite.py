"""The page of the benchmark suite: `python -m studies.benchmark_suite RESULTS...`.

Writes the table of docs/benchmark_suite.md from documents of `swarmctl exp bench -o json` and from
CSV files in the form of its option `--with`. Several files may have different seeds of one pattern.
Writes the picture of the tasks and the schema of their files, too. `make bench-suite` runs this
program.
"""

from __future__ import annotations

import json
import math
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import msgspec
import numpy as np

import swarmd.config
from benchmarks.table import markdown
from studies.outcomes.outcome import with_results
from swarmd.sim.experiments import benchmark
from swarmd.sim.lockstep.lockstep import simulate_run
from swarmd.sim.plots import scene
from swarmd.sim.plots.theme import new_figure, save
from swarmd.sim.scenarios.scenariofile import scenario_of
from swarmd.texts.values import NOTHING

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from swarmd.sim.experiments.benchmark import Task
    from swarmd.sim.scenarios.scenario import Scenario
    from swarmd.sim.trace import Trace

DOCS = Path(__file__).resolve().parents[1] / "docs"
PAGE, FIGURE = DOCS / "benchmark_suite.md", DOCS / "figures" / "benchmark_suite.png"
_DRAWN = ("floor", "light")
_NEST_COLOUR, _SOURCE_COLOUR, _DARK_FLOOR = "#4C72B0", "#55A868", "0.6"
_ROBOTS = ("robot that the metric judges", "other robot")
_COLUMNS = 5
_SCALE = 0.42  # inches of 1 m
_GAP = 0.5  # m between arenas of a line
_TITLE, _KEY = 0.32, 0.42  # inches
BAR = "1 m"
"""The gid of the bar that is 1 m long."""


def main(files: Sequence[str]) -> None:
    """Write page, picture and schema; without files the table stays."""
    folder = Path(swarmd.config.__path__[0]).resolve() / "benchmark"
    (folder / "schema.json").write_text(schema_text())
    draw(FIGURE)
    if files:
        PAGE.write_text(with_results(PAGE.read_text(), table(files)))


def schema_text() -> str:
    """The JSON schema of a file of the suite, a line for each of its structs."""
    schema = msgspec.json.schema(benchmark.CompleteTaskFile)
    defs = schema.pop("$defs")
    lines = [f"{json.dumps(name)}: {json.dumps(defs[name])}" for name in sorted(defs)]
    head = json.dumps(schema).rstrip("}")
    return f'{head}, "$defs": {{\n' + ",\n".join(lines) + "\n}}\n"


def table(files: Sequence[str]) -> str:
    """Markdown: a row for each pattern of each task, best first, from the seeds of all files."""
    values: dict[tuple[str, str], dict[int, float]] = {}
    for file in files:
        if file.endswith(".csv"):
            read = benchmark.read_results(Path(file), benchmark.task_names())
            for key, by_seed in read.items():
                values.setdefault(key, {}).update(by_seed)
            continue
        for task in json.loads(Path(file).read_text())["tasks"]:
            for row in task["results"]:
                known = values.setdefault((row["name"], task["name"]), {})
                known |= {int(s): math.nan if v is None else v for s, v in row["values"].items()}
    tasks = [benchmark.load_task(name) for name in benchmark.task_names()]
    cells = benchmark.table_of(values, {task.name: task.file.metric.better for task in tasks})
    rows = [["task", "rank", "pattern", "median", "95 %", "unit", "runs"]]
    for task in tasks:
        listed = [(row, of_row[task.name]) for row, of_row in cells.items() if task.name in of_row]
        for row, cell in sorted(listed, key=lambda item: (item[1].place, item[0])):
            summary = cell.summary
            between = summary.median_interval
            rows.append(
                [
                    *(f"`{task.name}`", str(cell.rank or NOTHING), f"`{row}`"),
                    NOTHING if summary.median is None else f"{summary.median:z.2f}",
                    NOTHING if between is None else f"{between.low:z.2f} to {between.high:z.2f}",
                    *(task.file.metric.unit, str(summary.n)),
                ]
            )
    return markdown(rows)


def draw(path: Path) -> None:
    """The tasks from above at the start of seed 0, with floors, lamps, boxes and places."""
    save(figure_of([benchmark.load_task(name) for name in benchmark.task_names()]), path)


def figure_of(tasks: Sequence[Task]) -> Figure:
    """The picture of the tasks: all arenas to one scale, without axes, above a key."""
    scenarios = [task.scenario(task.file.candidates[0].pattern) for task in tasks]
    traces = [simulate_run(scenario_of(s.effective, {"duration": 0.4}), 0) for s in scenarios]
    extents = [scene.extent_of(trace) for trace in traces]
    lines = [extents[k : k + _COLUMNS] for k in range(0, len(extents), _COLUMNS)]
    heights = [max(extent.height for extent in line) for line in lines]  # m
    widths = [max(line[k].width for line in lines if k < len(line)) for k in range(len(lines[0]))]
    across = _SCALE * (sum(widths) + _GAP * (len(widths) - 1))
    high = _KEY + sum(_SCALE * height + _TITLE for height in heights)
    figure = new_figure(across, high, is_map=True)
    figure.set_layout_engine("none")
    for number, (task, scenario, trace) in enumerate(zip(tasks, scenarios, traces, strict=True)):
        line, column = divmod(number, _COLUMNS)
        extent = extents[number]
        middle = _SCALE * (sum(widths[:column]) + _GAP * column + widths[column] / 2.0)
        top = high - sum(_SCALE * height + _TITLE for height in heights[:line]) - _TITLE
        width, height = _SCALE * extent.width, _SCALE * extent.height
        place = (middle - width / 2.0, top - height, width, height)
        axes = figure.add_axes(tuple(np.array(place) / (across, high, across, high)))
        _paint_task(axes, task, scenario, trace)
    _paint_key(figure, across, high)
    return figure


def _paint_task(axes: Axes, task: Task, scenario: Scenario, trace: Trace) -> None:
    from matplotlib.patches import Circle

    extent = scene.extent_of(trace)
    scene.prepare(axes, extent)
    axes.set_axis_off()
    fields = [field for field in scenario.fields if field.__struct_config__.tag in _DRAWN]
    scene.paint_fields(axes, trace, extent, fields, is_small=True)
    scene.paint_arena(axes, trace)
    for kind in scenario.items:
        for disc, colour in ((kind.source, _SOURCE_COLOUR), (kind.nest, _NEST_COLOUR)):
            if disc is not None:
                axes.add_patch(Circle(disc[:2], disc[2], fill=False, edgecolor=colour))
    scene.paint_movable_boxes(axes, trace)
    judged = {robot for name in task.file.groups for robot in scenario.groups[name]}
    colours = [scene.robot_colour(0 if robot in judged else 1) for robot in trace.ids]
    scene.paint_bodies(axes, trace, 0, colours, is_filled=True)
    axes.set_title(task.file.title, fontsize=9)


def _paint_key(figure: Figure, across: float, high: float) -> None:
    """A bar of 1 m, and what colours and lines are, below the arenas."""
    from matplotlib.lines import Line2D
    from matplotlib.patches import Patch

    left, level = 0.1 * _SCALE / across, 0.4 * _KEY / high
    bar = Line2D([left, left + _SCALE / across], [level] * 2, color="0.1", linewidth=2.0)
    bar.set_gid(BAR)
    figure.add_artist(bar)
    figure.text(left + _SCALE / across / 2.0, level, "1 m", fontsize=9, ha="center", va="bottom")
    robots = [Patch(color=scene.robot_colour(k), label=_ROBOTS[k]) for k in range(2)]
    rings = [
        Line2D(
            [], [], marker="o", markersize=9, linestyle="", fillstyle="none", color=c, label=text
        )
        for c, text in ((_NEST_COLOUR, "nest"), (_SOURCE_COLOUR, "source of items"))
    ]
    grounds = [
        Patch(color=scene.MOVABLE_BOX_COLOUR, label="box or item that moves"),
        Patch(color=_DARK_FLOOR, label="dark floor"),
        Line2D([], [], color="0.45", linewidth=0.8, label="lines of equal light"),
    ]
    figure.legend(handles=[*robots, *rings, *grounds], loc="center right", ncols=7, frameon=False,
                  fontsize=9, bbox_to_anchor=(1.0, level), columnspacing=1.3)  # fmt: skip


if __name__ == "__main__":
    main(sys.argv[1:])
