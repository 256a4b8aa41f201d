"""The cost of protection: goals reached, as a share of ghosts, which pass through each other."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

from benchmarks.table import markdown
from studies.safety.columns import COLUMNS, goals_a_minute, rows
from studies.safety.judgement import Judgement
from studies.safety.runs import Record, Task, total
from studies.safety.scenes import Scene

GHOST = "ghost"
MODES = (GHOST, "barrier", "potential_field", "stop_zone")


def plan(
    families: Iterable[str],
    platforms: Iterable[str],
    visibilities: Iterable[str],
    modes: Iterable[str],
    seeds: Sequence[int],
    duration: float,
) -> list[Task]:
    """Sparse and dense scenes, every mode with the same seeds, and ghosts for comparison."""
    chosen = dict.fromkeys((GHOST, *modes))
    return [
        Task(Scene(family, platform, visibility, mode, is_sparse, duration), seed)
        for family in families
        for platform in platforms
        for visibility in visibilities
        for is_sparse in (True, False)
        for mode in chosen
        for seed in seeds
    ]


def tables(records: Sequence[Record]) -> str:
    """Markdown, a table for each family, platform and density."""
    parts: dict[str, dict[str, list[Record]]] = {}
    for one in records:
        scene = one.task.scene
        area = scene.room.side**2 / scene.room.robots
        title = f"{scene.family}, {scene.platform}, {scene.visibility}, {area:.1f} m2 a robot"
        parts.setdefault(title, {}).setdefault(scene.mode, []).append(one)
    return "\n\n".join(f"### {title}\n\n{_table(modes)}" for title, modes in parts.items())


def _table(modes: dict[str, list[Record]]) -> str:
    ghosts = goals_a_minute(total(one.found for one in modes[GHOST]))

    def share(found: Judgement) -> str:
        reached = goals_a_minute(found)
        return "-" if reached is None or not ghosts else f"{reached / ghosts:.0%}"

    return markdown(rows("mode", modes, {**COLUMNS, "of ghosts": share}))
