"""Robot-hours of whole swarms under protection, and among ramming robots, over all scenes."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

from benchmarks.table import markdown
from studies.safety.columns import HOUR, rows
from studies.safety.runs import Record, Task
from studies.safety.scenes import FAMILIES, OWN, RAM, Scene


def cells(
    families: Iterable[str],
    platforms: Iterable[str],
    visibilities: Iterable[str],
    mode: str,
    duration: float,
) -> list[Scene]:
    """All scenes of these families."""
    places = [(p, v) for p in platforms for v in visibilities]
    return [Scene(f, p, v, mode, duration=duration) for f in families for p, v in places]


def plan(robot_hours: float, scenes: Sequence[Scene], seeds: Iterable[int]) -> list[Task]:
    """Rounds of all scenes, each with a new seed, until the robot-hours are reached.

    The project's own patterns run in every other round only, because they avoid others.
    """
    tasks: list[Task] = []
    planned = 0.0
    for number, seed in enumerate(seeds):
        for scene in scenes:
            if scene.family in OWN and number % 2:
                continue
            if planned >= robot_hours:
                return tasks
            tasks.append(Task(scene, seed))
            planned += scene.protected * scene.duration / HOUR
    return tasks


def tables(records: Sequence[Record]) -> str:
    """Markdown: by family and platform, both visibilities together, and the totals."""
    parts = []
    for title, is_ram in (("Everybody is protected", False), ("A third rams the others", True)):
        groups: dict[str, list[Record]] = {}
        for form in ("{0.family}, {0.platform}", "all, {0.platform}, {0.visibility}", "all"):
            for one in records:
                if (one.task.scene.family == RAM) == is_ram:
                    groups.setdefault(form.format(one.task.scene), []).append(one)
        if groups:
            parts.append(f"### {title}\n\n{markdown(rows(_ordered(groups), {}))}")
    return "\n\n".join(parts)


_ORDER = {name: number for number, name in enumerate(FAMILIES)}


def _ordered(groups: dict[str, list[Record]]) -> dict[str, list[Record]]:
    """Sorted by family; names without a family come last, in their order."""
    return dict(sorted(groups.items(), key=lambda item: _ORDER.get(item[0].partition(",")[0], 99)))
