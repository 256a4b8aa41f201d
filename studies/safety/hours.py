"""Robot-hours of whole swarms under protection, alone and among attackers, over all scenes."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

from benchmarks.table import markdown
from studies.safety.columns import EVIDENCE, HOUR, rows
from studies.safety.runs import Record, Task
from studies.safety.scenes import FAMILIES, PLATFORMS, Scene

_WHAT = "options of `python -m studies.safety hours`"


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
        if p in FAMILIES[f].platforms and v in FAMILIES[f].visibilities
    ]


def plan(
    robot_hours: float, scenes: Sequence[Scene], seeds: Iterable[int], *, is_whole: bool = False
) -> list[Task]:
    """Rounds of all scenes, each with a new seed, until the robot-hours are reached.

    The project's own patterns run in every other round only, because they avoid others. `is_whole`:
    the first round has all scenes, however long they take.
    """
    tasks: list[Task] = []
    planned = 0.0
    for number, seed in enumerate(seeds):
        for scene in scenes:
            if scene.of.is_own and number % 2:
                continue
            if planned >= robot_hours and (number or not is_whole):
                return tasks
            tasks.append(Task(scene, seed))
            planned += scene.protected * scene.duration / HOUR
    return tasks


def tables(records: Sequence[Record]) -> str:
    """Markdown: a row for each cell, named by its options, and the runs at fault by their command.

    docs/evidence/safety.md explains the columns.
    """
    alone = [one for one in records if not one.task.scene.of.attack]
    among = [one for one in records if one.task.scene.of.attack]
    parts = [
        f"#### {title}\n\n{markdown(rows(_WHAT, _groups(some), EVIDENCE))}"
        for title, some in (
            ("All robots are protected", alone),
            (
                "A third attacks the others, within the claim",
                [one for one in among if one.task.scene.of.is_claimed],
            ),
            (
                "A third attacks the others, beyond the claim",
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
        parts.append(f"#### Runs at fault\n\n{lines}")
    return "\n\n".join(parts)


def again(task: Task) -> str:
    """The command that repeats a run."""
    scene = task.scene
    words = f"{scene.family} {scene.platform} {scene.visibility} {scene.mode} {task.seed}"
    return f"python -m studies.safety one {words} --duration {scene.duration:g}"


def _groups(records: Sequence[Record]) -> dict[str, list[Record]]:
    found: dict[str, list[Record]] = {}
    for one in sorted(records, key=lambda one: _order(one.task.scene)):
        scene = one.task.scene
        words = f"{scene.family} --platforms {scene.platform} --visibilities {scene.visibility}"
        mode = "" if scene.mode == "barrier" else f" --mode {scene.mode}"
        found.setdefault(f"`--families {words}{mode}`", []).append(one)
    return {**found, "all": list(records)}


def _order(scene: Scene) -> tuple[int, int, str]:
    return list(FAMILIES).index(scene.family), PLATFORMS.index(scene.platform), scene.visibility
