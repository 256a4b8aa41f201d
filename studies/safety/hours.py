"""Robot-hours of whole swarms under protection, alone and among attackers, over all scenes."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

from benchmarks.table import markdown
from studies.safety.columns import HOUR, rows
from studies.safety.runs import Record, Task
from studies.safety.scenes import FAMILIES, VISIBILITIES, Scene


def cells(
    families: Iterable[str],
    platforms: Iterable[str],
    visibilities: Iterable[str],
    mode: str,
    duration: float,
) -> list[Scene]:
    """All scenes of these families, each with those of the platforms that it has."""
    places = [(p, v) for p in platforms for v in visibilities]
    return [
        Scene(f, p, v, mode, duration=duration)
        for f in families
        for p, v in places
        if p in FAMILIES[f].platforms
    ]


def plan(robot_hours: float, scenes: Sequence[Scene], seeds: Iterable[int]) -> list[Task]:
    """Rounds of all scenes, each with a new seed, until the robot-hours are reached.

    The project's own patterns run in every other round only, because they avoid others.
    """
    tasks: list[Task] = []
    planned = 0.0
    for number, seed in enumerate(seeds):
        for scene in scenes:
            if scene.of.is_own and number % 2:
                continue
            if planned >= robot_hours:
                return tasks
            tasks.append(Task(scene, seed))
            planned += scene.protected * scene.duration / HOUR
    return tasks


def tables(records: Sequence[Record]) -> str:
    """Markdown: a row for each cell, named by its command, and the runs at fault by theirs."""
    alone = [one for one in records if not one.task.scene.of.attack]
    among = [one for one in records if one.task.scene.of.attack]
    parts = [
        f"### {title}\n\n{markdown(rows(_groups(some), {}))}"
        for title, some in (
            ("All are protected", alone),
            (
                "A third attacks the others, as the claim covers",
                [one for one in among if one.task.scene.of.is_claimed],
            ),
            (
                "A third attacks the others, beyond the claim: severity",
                [one for one in among if not one.task.scene.of.is_claimed],
            ),
        )
        if some
    ]
    at_fault = [one for one in records if one.found.faults or one.found.touch_faults]
    if at_fault:
        lines = "\n".join(
            f"- `{again(one.task)}`: {100.0 * max(one.found.worst, one.found.worst_touch):.1f} cm/s"
            for one in at_fault
        )
        parts.append(f"### Runs at fault\n\n{lines}")
    return "\n\n".join(parts)


def again(task: Task) -> str:
    """The command that repeats a run."""
    scene = task.scene
    words = f"{scene.family} {scene.platform} {scene.visibility} {scene.mode} {task.seed}"
    return f"python -m studies.safety one {words} --duration {scene.duration:g}"


def _groups(records: Sequence[Record]) -> dict[str, list[Record]]:
    found: dict[str, list[Record]] = {}
    seen = {one.task.scene.visibility for one in records}
    which = "" if seen == set(VISIBILITIES) else f" --visibilities {' '.join(sorted(seen))}"
    for one in records:
        scene = one.task.scene
        name = f"`--families {scene.family} --platforms {scene.platform}{which}`"
        found.setdefault(name, []).append(one)
    order = list(FAMILIES)
    ordered = sorted(found.items(), key=lambda i: order.index(i[1][0].task.scene.family))
    return {**dict(ordered), "all": list(records)}
