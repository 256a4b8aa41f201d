"""The report of a referee: one HTML file with verdicts, seeds and bits."""

from __future__ import annotations

import os
import shlex
from collections.abc import Sequence
from dataclasses import dataclass
from html import escape
from pathlib import Path

from swarmd.operator.texts.values import NOTHING, counted
from swarmd.sim.experiments.manifest import Manifest
from swarmd.sim.experiments.referee import (
    ALPHA,
    AT,
    BETTER,
    FAULTS,
    OPEN,
    SOUND,
    STAND,
    WORSE,
    Case,
    Decision,
    Finding,
)
from swarmd.sim.experiments.results import Results
from swarmd.sim.experiments.statistics import number
from swarmd.sim.report.html import page
from swarmd.sim.report.tables import manifest_table, table

HEAD = (
    *("TASK", "CASE", "MEAN", "CONTROL", "ITS MEAN", "DIFFERENCE (95 %)"),
    *("VERDICT", "RUNS", "CONTACTS"),
)
HEAD_OF_RUNS = ("TASK", "CASE", "SEED", "VALUE", "BITS")


@dataclass(frozen=True, slots=True)
class Refereed:
    """All that a report shows. `digest`: of the controller's files; `bits`: of all runs."""

    controller: str
    digest: str
    command: Sequence[str]
    found: Sequence[tuple[Case, Results]]
    findings: Sequence[Finding]
    decisions: Sequence[Decision]
    misfits: Sequence[str]
    folder: Path
    bits: str


def referee_report(refereed: Refereed, manifest: Manifest) -> str:
    """The report as HTML; `manifest`: of any of the experiments."""
    return page(
        title=f"{Path(os.path.abspath(refereed.controller)).name}, refereed",
        sentence=sentence_of(refereed.findings),
        question=(
            f"The controller {refereed.controller} in tasks of the benchmark suite, beside robots"
            " that stand, and with a fault of one robot"
        ),
        summary=_summary(refereed, manifest),
        sections=[
            ("verdicts", "Verdicts", _verdicts(refereed)),
            ("until", "Requirements", _decisions(refereed.decisions)),
            ("misfits", "Tasks that it does not fit", _misfits(refereed.misfits)),
            ("again", "How to repeat it", _again(refereed)),
            ("runs", "Seeds and bits", _runs(refereed)),
            ("manifest", "Made with", manifest_table(manifest)),
        ],
    )


def sentence_of(findings: Sequence[Finding]) -> str:
    """The answer in short."""
    sound = [one for one in findings if one.case == SOUND]
    better = sum(one.verdict == BETTER for one in sound)
    loses = sum(one.verdict == WORSE for one in findings if one.case in FAULTS)
    faulty = sum(one.case in FAULTS for one in findings)
    return (
        f"Better than robots that stand in {better} of {counted(len(sound), 'task')}; worse with a"
        f" fault of one robot in {loses} of {counted(faulty, 'case')}"
    )


def rows_of(findings: Sequence[Finding]) -> list[tuple[str, ...]]:
    """The cells of HEAD for each case but the control, as text."""
    rows: list[tuple[str, ...]] = []
    for one in findings:
        if one.case == STAND:
            continue
        means = (NOTHING, NOTHING)
        gap = NOTHING
        if one.difference is not None:
            means = (
                _value(one.difference.mean_b, one.unit),
                _value(one.difference.mean_a, one.unit),
            )
            gap = number(one.difference.difference)
            if one.difference.interval is not None:
                low, high = one.difference.interval
                gap += f" ({number(low)} to {number(high)})"
        failed = f", {one.failed} failed" if one.failed else ""
        cells = (one.verdict, f"{one.runs}{failed}", str(one.contacts))
        rows.append((one.task, one.case, means[0], one.against or NOTHING, means[1], gap, *cells))
    return rows


def _value(value: float | None, unit: str) -> str:
    return number(value) + (f" {unit}" if unit and unit != "share" and value is not None else "")


def _verdicts(refereed: Refereed) -> str:
    rows = [tuple(map(escape, row)) for row in rows_of(refereed.findings)]
    text = (
        f"The control of {SOUND} is robots that stand, that of a fault is {SOUND}. Runs of the same"
        f" seed are pairs. A verdict other than {OPEN} has p below {ALPHA:g} with Holm's correction"
        f" for all rows. With a fault, the first robot has it from {AT:g} s on. Which of two values"
        " is better follows from the task's metric."
    )
    metrics = {
        case.task: (case.task, case.metric.name, case.metric.better or NOTHING, case.metric.meaning)
        for case, _ in refereed.found
    }
    meanings = table(("TASK", "METRIC", "BETTER", "MEANING"), _escaped([*metrics.values()]))
    return f'{table(HEAD, rows, "metrics")}<p class="dim">{escape(text)}</p>{meanings}'


def _decisions(decisions: Sequence[Decision]) -> str:
    rows = [
        (escape(one.until.text), escape(str(one.verdict)), str(one.runs), one.bits)
        for one in decisions
    ]
    return table(("REQUIREMENT", "RESULT", "SEEDS", "BITS"), rows, "metrics") if rows else ""


def _misfits(lines: Sequence[str]) -> str:
    items = "".join(f"<li>{escape(line)}</li>" for line in lines)
    return f"<ul>{items}</ul>" if items else ""


def _again(refereed: Refereed) -> str:
    place = shlex.quote(str(refereed.folder))
    lines = [
        shlex.join(refereed.command),
        f"swarmctl exp rerun {place}/TASK/CASE   # the runs of one case, compared bit by bit",
    ]
    files = f"The files of the controller have the digest {refereed.digest}. " * bool(
        refereed.digest
    )
    text = (
        f"{files}All runs together have the bits {refereed.bits}: who repeats the command with the"
    )
    text += " same files and the same version of swarmd gets these again."
    return f"<pre>{escape(chr(10).join(lines))}</pre><p>{escape(text)}</p>"


def _runs(refereed: Refereed) -> str:
    heads = [(one.task, one.case, str(one.runs), "", one.bits) for one in refereed.findings]
    each = [
        (case.task, case.case, str(row["seed"]), number(row.get(case.metric.name)), row["bits"])
        for case, results in refereed.found
        for row in results.rows
    ]
    summary = table(("TASK", "CASE", "RUNS", "", "BITS"), _escaped(heads), "metrics")
    whole = table(HEAD_OF_RUNS, _escaped(each), "metrics")
    return f"{summary}<details><summary>Each run</summary>{whole}</details>"


def _escaped(rows: Sequence[tuple[str, ...]]) -> list[tuple[str, ...]]:
    return [tuple(map(escape, row)) for row in rows]


def _summary(refereed: Refereed, manifest: Manifest) -> str:
    runs = sum(len(results.rows) for _, results in refereed.found)
    tasks = len({case.task for case, _ in refereed.found})
    return (
        f"{counted(runs, 'run')} in {counted(tasks, 'task')}; bits {refereed.bits}; made with"
        f" swarmd {manifest.made_with.get('swarmd', '')}, {manifest.created}"
    )
