"""`swarmctl class`: the work of a class, marked by the targets of the tutorial's lessons."""

from __future__ import annotations

import shutil
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING, Any

import click

from swarmd.cli.options import FOLDER, VerbGroup
from swarmd.cli.output import print_json, print_table, warn
from swarmd.core.errors import ConfigError, SwarmError, unknown
from swarmd.sim.cli.options import need, output_option
from swarmd.sim.experiments.cores import MAX_PROCESSES, usable_cores

if TYPE_CHECKING:
    from swarmd.cli.plugin_check import Point
    from swarmd.sim.experiments.lessons import Lesson, LessonMark
    from swarmd.sim.experiments.plan import Plan

FAILED = 1  # exit code
_CHECK_TIMEOUT = 30.0  # s for one point of the check of a pattern
_LETTERS = "ABCDEFGHIJKLMNOPQRSTUVWXYZ"


@dataclass(frozen=True, slots=True)
class Work:
    """The work of a pupil with the results of its checks."""

    pupil: str
    checks: Sequence[Point] = ()  # the points of `plugin check`
    mark: LessonMark | None = None
    why: str = ""  # the first fault; empty without one

    @property
    def is_passed(self) -> bool:
        """True if the work has a mark and no fault."""
        return self.mark is not None and not self.why

    def document(self) -> dict[str, Any]:
        """The work as plain values."""
        findings = self.mark.findings if self.mark is not None else ()
        return {
            "pupil": self.pupil,
            "passed": self.is_passed,
            "why": self.why,
            "checks": [
                {"point": one.name, "result": one.result, "text": one.text} for one in self.checks
            ],
            "requirements": [one.document() for one in findings],
        }


@click.group("class", cls=VerbGroup, epilog="Example: swarmctl class check handed-in --lesson 2")
def classroom() -> None:
    """Mark what a class hands in for the lessons of the tutorial."""


@classroom.command()
@output_option
def lessons(is_json: bool) -> None:
    """List the lessons, what a pupil hands in for each, and the targets."""
    from swarmd.sim.experiments.lessons import load_lessons

    found = load_lessons()
    if is_json:
        rows = [
            {"lesson": number, "title": one.title, "hand_in": _wanted(one), "targets": one.targets}
            for number, one in found.items()
        ]
        print_json("Lessons", {"lessons": rows})
        return
    table = [
        (number, one.title, ", ".join(_wanted(one)), text)
        for number, one in found.items()
        for text in _targets(one)
    ]
    print_table(("LESSON", "TITLE", "HAND IN", "TARGET"), table)


@classroom.command()
@click.argument("folder", type=FOLDER, required=False)
@click.option("--lesson", metavar="NUMBER", help="One of `swarmctl class lessons`.")
@click.option(
    "-j",
    "--jobs",
    type=click.IntRange(1, MAX_PROCESSES),
    help="Runs at a time; results do not depend on it [all cores].",
)
@click.option(
    "--timeout",
    type=click.FloatRange(min=1.0),
    default=300.0,
    metavar="SECONDS",
    help="All runs of one pupil together; the others continue [300].",
)
@output_option
@click.pass_context
def check(
    ctx: click.Context,
    folder: Path | None,
    lesson: str | None,
    jobs: int | None,
    timeout: float,
    is_json: bool,
) -> None:
    """Mark the work in FOLDER, which has a folder for each pupil.

    For a lesson with a pattern a pupil may hand in the file alone, as FOLDER/PUPIL.py: it passes
    `plugin check`, then the experiment of the lesson runs with it, with fixed seeds. For the other
    lessons the results in the pupil's folder are compared with the targets. `class lessons` lists
    what is wanted.

    Exit code 0 if the work of all pupils passes, else 1.
    """
    need("mujoco")
    from swarmd.sim.experiments.lessons import load_lessons, plan_of_lesson

    known = load_lessons()
    if folder is None or lesson is None:
        lacking = "FOLDER" if folder is None else "--lesson NUMBER"
        text = "type: swarmctl class check FOLDER --lesson 2, where FOLDER holds PUPIL.py or PUPIL/"
        raise click.UsageError(f"{lacking} is missing; {text} of each pupil")
    if lesson not in known:
        raise click.UsageError(unknown("lesson", lesson, known))
    wanted = known[lesson]
    handed_in = _handed_in(folder, wanted)
    if not handed_in:
        suffix = " and no PUPIL.py" if wanted.pattern else ""
        raise ConfigError(f"{folder}: no folder of a pupil{suffix} is in it")
    plan = plan_of_lesson(wanted) if wanted.pattern else None
    works = []
    for path in handed_in:
        work = _marked(path, wanted, plan, jobs or usable_cores(), timeout)
        works.append(work)
        warn(f"{len(works)} of {len(handed_in)}: {work.pupil} {_verdict(work)}")
    if is_json:
        rows = [one.document() for one in works]
        print_json("Class", {"lesson": lesson, "targets": wanted.targets, "pupils": rows})
    else:
        _print(wanted, works)
    ctx.exit(0 if all(work.is_passed for work in works) else FAILED)


def _handed_in(folder: Path, lesson: Lesson) -> list[Path]:
    """The folders of pupils, and for a lesson with a pattern their files, by name."""
    if not folder.is_dir():
        raise click.UsageError(f"{folder}: no such folder")
    if any((folder / one).exists() for one in _wanted(lesson)):
        raise click.UsageError(f"{folder} is the folder of one pupil; name the folder above it")
    return sorted(
        path
        for path in folder.iterdir()
        if not path.name.startswith((".", "__"))
        and (path.is_dir() or (lesson.pattern and path.suffix == ".py"))
    )


def _marked(path: Path, lesson: Lesson, plan: Plan | None, processes: int, timeout: float) -> Work:
    """Check and mark the work of one pupil; a fault of the work is returned, not raised."""
    from swarmd.sim.experiments.lessons import mark_pattern, mark_results

    pupil = path.name if path.is_dir() else path.stem
    checks: list[Point] = []
    try:
        if plan is None:
            mark = mark_results(lesson, path)
            return Work(pupil, mark=mark, why=mark.why)
        with _folder_of(path, lesson) as folder:
            checks = _checked(folder, lesson)
            if why := next((_fault(one) for one in checks if one.result != "ok"), ""):
                return Work(pupil, checks, why=why)
            mark = mark_pattern(lesson, plan, folder, processes=processes, timeout=timeout)
            return Work(pupil, checks, mark, mark.why)
    except (SwarmError, OSError) as error:
        return Work(pupil, checks, why=" ".join(str(error).split()))


@contextmanager
def _folder_of(path: Path, lesson: Lesson) -> Iterator[Path]:
    """The folder with the lesson's pattern: the pupil's, or one with the pupil's file."""
    if path.is_dir():
        yield path.absolute()
        return
    with TemporaryDirectory(prefix="swarmd-class-") as name:
        shutil.copyfile(path, Path(name) / f"{lesson.pattern}.py")
        yield Path(name)


def _checked(folder: Path, lesson: Lesson) -> list[Point]:
    from swarmd.cli.plugin_check import check_file
    from swarmd.sim.experiments.lessons import pattern_file

    return list(check_file(pattern_file(folder, lesson), _CHECK_TIMEOUT))


def _fault(point: Point) -> str:
    return f"{point.name}: {point.text}" if point.text else point.name


def _print(lesson: Lesson, works: Sequence[Work]) -> None:
    """The targets by letter, and a row for each pupil; `!` marks a value that misses its target."""
    targets = _targets(lesson)
    for letter, text in zip(_LETTERS, targets, strict=False):
        click.echo(f"{letter}  {text}")
    click.echo()
    header = ("PUPIL", "CHECKS", *_LETTERS[: len(targets)], "VERDICT", "WHY")
    print_table(header, [_row(lesson, work, len(targets)) for work in works])
    passed = sum(work.is_passed for work in works)
    warn(f"{passed} of {len(works)} passed")


def _row(lesson: Lesson, work: Work, count: int) -> tuple[str, ...]:
    well = sum(one.result == "ok" for one in work.checks)
    checks = f"{well}/{len(work.checks)}" if work.checks else "-"
    found = work.mark.findings if work.mark is not None else ()
    by_target = {
        _name(place, one.requirement.text): one
        for place in lesson.targets
        for one in found
        if one.variant == place.partition(":")[2]
    }
    values = [
        "-"
        if (one := by_target.get(target)) is None
        else f"{'-' if one.value is None else f'{one.value:.3g}'}{'' if one.is_met else '!'}"
        for target in _targets(lesson)
    ]
    return (work.pupil, checks, *values, _verdict(work), work.why or "-")


def _targets(lesson: Lesson) -> list[str]:
    """The targets of a lesson, each with its variant, in the order of the file."""
    return [_name(place, text) for place, texts in lesson.targets.items() for text in texts]


def _name(place: str, text: str) -> str:
    variant = place.partition(":")[2]
    return f"{text}, with {variant}" if variant else text


def _wanted(lesson: Lesson) -> list[str]:
    """What a pupil hands in: a file, or folders of results."""
    if lesson.pattern:
        return [f"{lesson.pattern}.py"]
    return list(dict.fromkeys(place.partition(":")[0] for place in lesson.targets))


def _verdict(work: Work) -> str:
    return "passed" if work.is_passed else "failed"
