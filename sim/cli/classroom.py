"""`swarmctl class`: the work of a class, marked by the targets of the tutorial's lessons."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from hashlib import sha256
from pathlib import Path
from signal import SIGTERM
from tempfile import TemporaryDirectory
from types import MappingProxyType
from typing import TYPE_CHECKING, Any

import click

from swarmd.core.errors import ConfigError, SwarmError, unknown
from swarmd.core.files import read_regular
from swarmd.operator.cli.options import FOLDER, VerbGroup
from swarmd.operator.cli.output import print_json, print_table, signals_end, table_lines, warn
from swarmd.operator.texts.values import printable
from swarmd.sim.cli.options import fresh_option, need, output_option
from swarmd.sim.experiments.cores import MAX_PROCESSES, usable_cores

if TYPE_CHECKING:
    from swarmd.operator.cli.plugin_check import Point
    from swarmd.sim.experiments.known_runs import KnownRuns
    from swarmd.sim.experiments.lessons import Lesson, LessonMark
    from swarmd.sim.experiments.plan import Plan
    from swarmd.sim.experiments.requirements import RequirementFinding

FAILED = 1  # exit code
_CHECK_TIMEOUT = 30.0  # s for one point of the check of a pattern
_LETTERS = "ABCDEFGHIJKLMNOPQRSTUVWXYZ"
_VALUE_WIDTH = 7  # characters of most values, such as 0.0123!
_SIGNS = MappingProxyType({"met": "", "not met": "!", "undecided": "?"})
"""Behind a value, by the verdict on its target."""


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
                {"point": point.name, "result": point.result, "text": point.text}
                for point in self.checks
            ],
            "requirements": [finding.document() for finding in findings],
        }


@click.group("class", cls=VerbGroup, epilog="Example: swarmctl class check handed-in --lesson 2")
def classroom() -> None:
    """Mark what a class hands in for the lessons of the tutorial."""


@classroom.command()
@output_option
def lessons(is_json: bool) -> None:
    """List the lessons, what a pupil hands in for each, and the targets."""
    from swarmd.sim.experiments.lessons import load_lessons

    lesson_by_number = load_lessons()
    if is_json:
        rows = [
            {
                "lesson": number,
                "title": lesson.title,
                "hand_in": _wanted(lesson),
                "targets": lesson.targets,
            }
            for number, lesson in lesson_by_number.items()
        ]
        print_json("Lessons", {"lessons": rows})
        return
    table = [
        (number, lesson.title, ", ".join(_wanted(lesson)), text)
        for number, lesson in lesson_by_number.items()
        for text in _targets(lesson)
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
@fresh_option
@output_option
@click.pass_context
def check(
    ctx: click.Context,
    folder: Path | None,
    lesson: str | None,
    jobs: int | None,
    timeout: float,
    is_fresh: bool,
    is_json: bool,
) -> None:
    """Mark the work of a class: FOLDER holds a folder FOLDER/PUPIL for each pupil.

    `class lessons` lists what each lesson asks for, and its targets.

    In a lesson with a pattern, each pupil's pattern has to pass `plugin check`. Then the experiment
    of the lesson runs with this pattern and fixed seeds, and its metrics have to meet the targets.
    A pupil may hand in the pattern's file without a folder, as FOLDER/PUPIL.py.

    In a lesson without a pattern, the experiments in the pupil's folder have to meet the targets.

    Exit code 0 if the work of all pupils passes, else 1.
    """
    need("mujoco")
    from swarmd.sim.experiments.known_runs import known_runs
    from swarmd.sim.experiments.lessons import load_lessons, plan_of_lesson

    # 1. The lesson, and the files or folders that pupils handed in.
    lessons = load_lessons()
    if folder is None or lesson is None:
        missing_word = "FOLDER" if folder is None else "--lesson NUMBER"
        raise click.UsageError(
            f"{missing_word} is missing; type: swarmctl class check FOLDER --lesson 2, where FOLDER"
            " holds PUPIL.py or PUPIL/ of each pupil"
        )
    if lesson not in lessons:
        raise click.UsageError(unknown("lesson", lesson, lessons))
    chosen_lesson = lessons[lesson]
    pupil_paths = _handed_in(folder, chosen_lesson)
    if not pupil_paths:
        suffix = " and no PUPIL.py" if chosen_lesson.pattern else ""
        raise ConfigError(f"{folder}: no folder of a pupil{suffix} is in it")

    # 2. The mark of each pupil. A row, or in JSON a line on stderr, follows as soon as it is known.
    plan = plan_of_lesson(chosen_lesson) if chosen_lesson.pattern else None
    known = known_runs(is_fresh=is_fresh)
    works: list[Work] = []
    table = _Table(chosen_lesson, [_pupil(path) for path in pupil_paths])
    try:
        if not is_json:
            table.print_head()
        with signals_end(SIGTERM):
            for path in pupil_paths:
                work = _marked(path, chosen_lesson, plan, jobs or usable_cores(), timeout, known)
                works.append(work)
                if is_json:
                    warn(f"{len(works)} of {len(pupil_paths)}: {work.pupil} {_verdict(work)}")
                else:
                    table.print_row(work)
    finally:  # also if somebody presses Ctrl-C
        not_done = [_pupil(path) for path in pupil_paths[len(works) :]]
        same_files = _same_files(pupil_paths, chosen_lesson)
        if is_json:
            about = {"lesson": lesson, "targets": chosen_lesson.targets, "same_files": same_files}
            pupils = [work.document() for work in works]
            print_json("Class", {**about, "pupils": pupils, "not_done": not_done})
        else:
            warn(f"{sum(work.is_passed for work in works)} of {len(works)} passed")
        if not_done:
            warn(f"not done: {', '.join(not_done)}")

    # 3. What was not done again, what the pupils share, and the exit code.
    for line in [] if known is None else known.lines():
        warn(line)
    for names in same_files:
        warn(f"the same file: {', '.join(names)}")
    ctx.exit(0 if all(work.is_passed for work in works) else FAILED)


def _handed_in(folder: Path, lesson: Lesson) -> list[Path]:
    """Paths in `folder`, sorted: a folder for each pupil, in a lesson with a pattern also files."""
    if not folder.is_dir():
        raise click.UsageError(f"{folder}: no such folder")
    if any((folder / name).exists() for name in _wanted(lesson)):
        raise click.UsageError(f"{folder} is the folder of one pupil; name the folder above it")
    return sorted(
        path
        for path in folder.iterdir()
        if not path.name.startswith((".", "__"))
        and (path.is_dir() or (lesson.pattern and path.suffix == ".py"))
    )


def _same_files(paths: Sequence[Path], lesson: Lesson) -> list[list[str]]:
    """The names of pupils who handed in files with equal bytes, one list for each such file.

    Only patterns are compared: equal results may come from two runs of the same experiment.
    """
    names_by_digest: dict[bytes, list[str]] = {}
    for path in paths if lesson.pattern else ():
        file = path / f"{lesson.pattern}.py" if path.is_dir() else path
        with suppress(OSError):  # the verdict names the fault
            digest = sha256(read_regular(file)).digest()
            names_by_digest.setdefault(digest, []).append(_pupil(path))
    return [names for names in names_by_digest.values() if len(names) > 1]


def _pupil(path: Path) -> str:
    return path.name if path.is_dir() else path.stem


def _marked(
    path: Path,
    lesson: Lesson,
    plan: Plan | None,
    processes: int,
    timeout: float,
    known: KnownRuns | None,
) -> Work:
    """Check and mark the work of one pupil; a fault of the work is returned, not raised."""
    from swarmd.sim.experiments.lessons import mark_pattern, mark_results

    pupil = _pupil(path)
    checks: list[Point] = []
    try:
        if plan is None:  # a lesson without a pattern
            mark = mark_results(lesson, path)
            return Work(pupil, mark=mark, why=mark.why)
        with _folder_of(path, lesson) as folder:
            checks = _checked(folder, lesson)
            if why := next((_fault(point) for point in checks if point.result != "ok"), ""):
                return Work(pupil, checks, why=why)
            mark = mark_pattern(
                lesson, plan, folder, processes=processes, timeout=timeout, known=known
            )
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
        (Path(name) / f"{lesson.pattern}.py").write_bytes(read_regular(path))
        yield Path(name)


def _checked(folder: Path, lesson: Lesson) -> list[Point]:
    from swarmd.operator.cli.plugin_check import check_file
    from swarmd.sim.experiments.lessons import pattern_file

    return list(check_file(pattern_file(folder, lesson), _CHECK_TIMEOUT))


def _fault(point: Point) -> str:
    return f"{point.name}: {point.text}" if point.text else point.name


class _Table:
    """The targets by letter, and a row for each pupil, with the signs of `_value_text`.

    `pupils`: the names of all rows, by which the columns are aligned before the rows are known.
    """

    def __init__(self, lesson: Lesson, pupils: Sequence[str]) -> None:
        self._lesson = lesson
        self._targets = _targets(lesson)
        self._header = ("PUPIL", "CHECKS", *_LETTERS[: len(self._targets)], "VERDICT", "WHY")
        values = (_VALUE_WIDTH for _ in self._targets)
        self._widths = (max(map(len, map(printable, pupils))), len("CHECKS"), *values)

    def print_head(self) -> None:
        """Print the targets and the header."""
        for letter, text in zip(_LETTERS, self._targets, strict=False):
            click.echo(f"{letter}  {text}")
        click.echo()
        click.echo(table_lines(self._header, [], least=self._widths)[0])

    def print_row(self, work: Work) -> None:
        """Print the row of a pupil."""
        row = _row(self._lesson, work)
        click.echo(table_lines(self._header, [row], least=self._widths)[1])


def _row(lesson: Lesson, work: Work) -> tuple[str, ...]:
    """A row of the table: pupil, passed checks, a value for each target, verdict, reason."""
    passed_checks = sum(point.result == "ok" for point in work.checks)
    checks = f"{passed_checks}/{len(work.checks)}" if work.checks else "-"
    findings = work.mark.findings if work.mark is not None else ()
    finding_by_target = {
        _name(place, finding.requirement.text): finding
        for place in lesson.targets
        for finding in findings
        if finding.variant == place.partition(":")[2]
    }
    values = [_value_text(finding_by_target.get(target)) for target in _targets(lesson)]
    return (work.pupil, checks, *values, _verdict(work), work.why or "-")


def _value_text(finding: RequirementFinding | None) -> str:
    """A value with `!` if it misses its target, `?` if the runs leave that open; `-` without it."""
    if finding is None:
        return "-"
    value = "-" if finding.value is None else f"{finding.value:.3g}"
    return f"{value}{_SIGNS[finding.verdict]}"


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
