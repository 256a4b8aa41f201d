"""The page of the benchmark suite: `python -m studies.benchmark_suite RESULTS...`.

Writes the table of docs/benchmark_suite.md from documents of `swarmctl exp bench -o json` and from
CSV files as of `--with`; several may hold other seeds of the same pattern. Writes the picture of
the tasks and the schema of their files, too. `make bench-suite` runs it.
"""

from __future__ import annotations

import json
import math
import sys
from collections.abc import Sequence
from pathlib import Path

import swarmd.config
from benchmarks.table import markdown
from studies.outcomes.outcome import with_results
from swarmd.sim.experiments import benchmark
from swarmd.sim.experiments.statistics import NOTHING
from swarmd.sim.lockstep.lockstep import simulate_run
from swarmd.sim.plots import scene
from swarmd.sim.plots.theme import new_figure, save
from swarmd.sim.scenarios.scenariofile import scenario_of

DOCS = Path(__file__).resolve().parents[1] / "docs"
PAGE, FIGURE = DOCS / "benchmark_suite.md", DOCS / "figures" / "benchmark_suite.png"
_DRAWN = ("floor", "light")
_NEST_COLOUR, _SOURCE_COLOUR = "#4C72B0", "#55A868"


def main(files: Sequence[str]) -> None:
    """Write page, picture and schema; without files the table stays."""
    folder = Path(swarmd.config.__path__[0]).resolve() / "benchmark"
    (folder / "schema.json").write_text(benchmark.schema_text())
    draw(FIGURE)
    if files:
        PAGE.write_text(with_results(PAGE.read_text(), table(files)))


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
    """The ten tasks from above at the start of seed 0, with floors, lamps, boxes and places."""
    from matplotlib.patches import Circle

    figure = new_figure(12.0, 6.2, is_map=True)
    tasks = [benchmark.load_task(name) for name in benchmark.task_names()]
    panels = figure.subplots(2, (len(tasks) + 1) // 2).ravel()
    for axes, task in zip(panels, tasks, strict=True):
        scenario = task.scenario(task.file.candidates[0].pattern)
        short = scenario_of(scenario.effective, {"duration": 0.4})
        trace = simulate_run(short, 0)
        extent = scene.extent_of(trace)
        scene.prepare(axes, extent)
        fields = [field for field in scenario.fields if field.__struct_config__.tag in _DRAWN]
        scene.paint_fields(axes, trace, extent, fields, is_small=True)
        scene.paint_arena(axes, trace)
        for kind in scenario.items:
            for disc, colour in ((kind.source, _SOURCE_COLOUR), (kind.nest, _NEST_COLOUR)):
                if disc is not None:
                    axes.add_patch(Circle(disc[:2], disc[2], fill=False, edgecolor=colour))
        scene.paint_movable_boxes(axes, trace)
        judged = {r for name in task.file.groups for r in scenario.groups[name]}
        colours = [scene.robot_colour(0 if robot in judged else 1) for robot in trace.ids]
        scene.paint_bodies(axes, trace, 0, colours, is_filled=True)
        axes.set_title(task.file.title, fontsize=9)
    save(figure, path)


if __name__ == "__main__":
    main(sys.argv[1:])
