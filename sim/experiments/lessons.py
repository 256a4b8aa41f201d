"""The lessons of the tutorial, and the check of a pupil's work against the lesson's targets.

In a lesson with a pattern, a pupil hands in a pattern, which is simulated. The processes of this
simulation are confined: of the user's files they can read only the pupil's folder, they cannot
write files, and they can grow by 1 GB at most. In the other lessons a pupil hands in a folder of
results.
"""

from __future__ import annotations

import time
from collections.abc import Iterator, Mapping, Sequence
from contextlib import closing
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

from msgspec import Struct

import swarmd.config
from swarmd.core.errors import ConfigError, SwarmError
from swarmd.settings.layered import Layered
from swarmd.settings.yamlfile import read, shown
from swarmd.sim.experiments.compare import Side, sides_of
from swarmd.sim.experiments.cores import core_share
from swarmd.sim.experiments.known_runs import KnownRuns
from swarmd.sim.experiments.plan import Plan
from swarmd.sim.experiments.pool import STEP_TIMEOUT, Job, JobResult, run_jobs
from swarmd.sim.experiments.requirements import (
    RUNS,
    RequirementFinding,
    Verdict,
    check,
    parse_requirement,
)
from swarmd.sim.experiments.results import Results
from swarmd.sim.experiments.simulate import Runner, plan_of
from swarmd.sim.experiments.store import Row
from swarmd.sim.metrics.catalog import METRICS
from swarmd.sim.metrics.protection import FAILED_PATTERNS
from swarmd.sim.scenarios.scenariofile import scenario_of


class Lesson(Struct, frozen=True, forbid_unknown_fields=True):
    """A lesson of the tutorial. A lesson with a `pattern` is run in its `scenario`."""

    title: str
    targets: dict[str, list[str]]  # requirements by `FOLDER[:VARIANT]`, a folder of results
    pattern: str = ""  # the name of the pattern and of the file that a pupil hands in
    seeds: int = 1  # the number of seeds, from 0 on
    sweep: dict[str, list[Any]] = {}  # each combination of these values is run
    scenario: dict[str, Any] = {}  # without a pattern


class _LessonsFile(Struct, frozen=True, forbid_unknown_fields=True):
    lessons: dict[str, Lesson]


@dataclass(frozen=True, slots=True)
class LessonMark:
    """The check of a pupil's work."""

    findings: Sequence[RequirementFinding] = ()
    """A finding for each target that has results."""
    why: str = ""
    """The first fault in one line; empty if no target is missed. An undecided target is none."""


def load_lessons() -> Mapping[str, Lesson]:
    """The lessons by number; ConfigError names the key of `config/lessons.yaml` that is wrong."""
    path = Path(swarmd.config.__path__[0]) / "lessons.yaml"
    return Layered((shown(path), read(path))).build(_LessonsFile).lessons


def plan_of_lesson(lesson: Lesson) -> Plan:
    """The runs of a lesson that has a pattern; its robots run none yet."""
    return plan_of(scenario_of(lesson.scenario), range(lesson.seeds), sweep=lesson.sweep)


def mark_results(lesson: Lesson, folder: Path) -> LessonMark:
    """The mark of the results that a pupil's folder holds."""
    findings: list[RequirementFinding] = []
    faults: list[str] = []
    for where, texts in lesson.targets.items():
        try:
            sides = sides_of(str(folder / where))
            _check_measured(sides[0].results, texts)
            findings += _findings(sides, texts)
            if lacking := sides[0].results.lacking:
                faults.append(f"{where}: {lacking}")
        except (SwarmError, OSError) as error:
            faults.append(str(error).replace(f"{folder}/", ""))
    return LessonMark(findings, next(iter([*faults, *_missed(findings)]), ""))


def mark_pattern(
    lesson: Lesson,
    plan: Plan,
    folder: Path,
    *,
    processes: int,
    timeout: float,
    known: KnownRuns | None = None,
) -> LessonMark:
    """Run the lesson's experiment with the pattern in a pupil's folder, and check its targets.

    `plan`: of `plan_of_lesson`, whose robots here run the pupil's pattern.
    `processes`: runs at a time. `timeout`: s of all runs, as `_bounded` counts. `known`: runs that
    need not be done; None: all are done. The first run that fails ends the experiment, and the
    reason is `why` of the result.
    """
    run_by_id = {run.id: run for run in plan.runs}
    # `guest` confines the process of the run to the pupil's folder.
    jobs = [
        Job(
            run.id,
            {**run.variant.effective, "pattern": lesson.pattern, "plugin_dir": str(folder)},
            run.seed,
            trace=None,
            guest=folder,
        )
        for run in plan.runs
    ]
    row_by_id: dict[str, Row] = {}
    for result in _bounded(jobs, processes, timeout, known):
        run = run_by_id[result.run]
        if result.metrics is None:
            reason = result.reason.rstrip(": ")  # an error without a text ends in a colon
            return LessonMark(why=f"{run.title}: {reason}")
        if FAILED_PATTERNS in result.errors:
            return LessonMark(why=f"{run.title}: {result.errors[FAILED_PATTERNS]}")
        row_by_id[run.id] = Row(run, result.metrics, None if result.stored else result.wall)
    if len(row_by_id) < len(jobs):
        done = f"{len(row_by_id)} of {len(jobs)} runs"
        return LessonMark(why=f"the pattern is too slow: {done} are done after {timeout:g} s")
    rows = [row_by_id[run.id] for run in plan.runs]
    results = Results(folder, plan, rows, {}, tuple(METRICS))
    findings: list[RequirementFinding] = []
    for place, texts in lesson.targets.items():  # FOLDER:VARIANT, or FOLDER for the only variant
        _, _, variant = place.partition(":")
        findings += _findings([Side(place, results, variant)], texts)
    return LessonMark(findings, next(_missed(findings), ""))


def _bounded(
    jobs: Sequence[Job], processes: int, timeout: float, known: KnownRuns | None
) -> Iterator[JobResult]:
    """The results that arrive within `timeout` s; the caller may close the iterator early.

    At a load above the cores of the machine the seconds count less (`core_share`).
    """
    spent = 0.0
    last = time.monotonic()
    step = min(STEP_TIMEOUT, timeout / 2.0)
    runner: Runner = partial(run_jobs, processes=processes, timeout=step)
    if known is not None:
        runner = known.runner(runner)
    with closing(runner(jobs)) as results:
        for result in results:
            if isinstance(result, JobResult):
                yield result
            now = time.monotonic()
            spent += (now - last) * core_share()
            last = now
            if spent > timeout:
                return


def _findings(sides: Sequence[Side], texts: Sequence[str]) -> list[RequirementFinding]:
    return [check(parse_requirement(text), side) for side in sides for text in texts]


def _check_measured(results: Results, texts: Sequence[str]) -> None:
    """ConfigError if runs lack a metric: a pupil's file would measure it, in this process."""
    for requirement in map(parse_requirement, texts):
        if requirement.metric not in (RUNS, *results.metrics):
            raise ConfigError(f"{results.folder}: the runs have not measured {requirement.metric}")


def _missed(findings: Sequence[RequirementFinding]) -> Iterator[str]:
    for finding in findings:
        if finding.verdict is Verdict.NOT_MET:
            what, wanted = finding.requirement.text.split(finding.requirement.comparison, 1)
            where = f" with {finding.variant}" if finding.variant else ""
            value = f"is {finding.value:.3g}" if finding.value is not None else "has no value"
            remark = f" ({finding.remark})" if finding.remark else ""
            limit = f"{finding.requirement.comparison} {wanted.strip()}"
            yield f"{what.strip()} {value}{where}, not {limit}{remark}"


def pattern_file(folder: Path, lesson: Lesson) -> Path:
    """The file of the lesson's pattern in a pupil's folder; ConfigError if it is not there."""
    file = folder / f"{lesson.pattern}.py"
    if not file.is_file():
        others = sorted(path.name for path in folder.glob("*.py"))
        raise ConfigError(f"no {file.name}{f', but {others[0]}' if others else ''}")
    return file
