"""`swarmctl exp run FILE/outcomes.yaml` and `exp check` of its folder: rows of outcomes."""

from __future__ import annotations

import itertools
import shlex
import time
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import click

from swarmd.core.errors import ConfigError, SwarmError
from swarmd.operator.cli.output import print_json, print_table, warn
from swarmd.operator.texts.values import counted
from swarmd.sim.cli.exp_runs import command_line, do_runs, exit_code
from swarmd.sim.cli.options import engine, need, new_folder, warn_of_few
from swarmd.sim.cli.progress import time_span

if TYPE_CHECKING:
    from swarmd.sim.experiments.outcomes import OutcomeFinding
    from swarmd.sim.experiments.results import Results

_REFUSED = {
    "pattern": "--pattern",
    "plugin_dir": "--plugin-dir",
    "sets": "--set",
    "sweeps": "--sweep",
    "shard": "--shard",
    "until": "--until",
    "alpha": "--alpha",
    "most": "--most",
    "metrics": "--metrics",
}
"""Options of `exp run` that do not go with a file of outcomes, by parameter."""


@dataclass(frozen=True, slots=True, kw_only=True)
class RunOptions:
    """The options of `exp run` that go with a file of outcomes."""

    out: Path | None
    jobs: int | None
    cores: int | None
    timeout: float | None
    on: str | None
    scheduler_file: Path | None
    is_fresh: bool
    no_traces: bool
    is_json: bool


def run_outcomes(ctx: click.Context, name: str, seeds: str, options: RunOptions) -> int:
    """Do the runs of a file of outcomes, print what they reach; returns the exit code.

    The runs of each name are an experiment of their own, a folder in the folder of the results. All
    rows and all runs are checked before the first run. ConfigError for an option of `exp run` that
    does not go with such a file.
    """
    # 1. The rows, and the plan of all runs.
    need("mujoco")
    from swarmd.core.files import read_regular, write_whole
    from swarmd.sim.experiments.manifest import NAME as MANIFEST
    from swarmd.sim.experiments.manifest import manifest_of
    from swarmd.sim.experiments.outcomes import (
        NAME,
        judge_all,
        left_out_seeds,
        outcomes_file,
        read_outcomes,
    )
    from swarmd.sim.experiments.plan import parse_seeds
    from swarmd.sim.experiments.store import recorded_in
    from swarmd.sim.metrics.catalog import beyond_catalog

    given = {
        parameter
        for parameter in (*_REFUSED, "seeds")
        if ctx.get_parameter_source(parameter) is click.core.ParameterSource.COMMANDLINE
    }
    for parameter, option in _REFUSED.items():
        if parameter in given:
            raise ConfigError(
                f"{option} does not go with {name}, which says what is run and measured; change a"
                " copy of the file, or leave the option out"
            )
    outcomes = read_outcomes(outcomes_file(name))
    own_seeds = parse_seeds(seeds) if "seeds" in given else None
    metrics = {runs: outcomes.metrics(runs) for runs in outcomes.runs}
    plans = {
        runs: outcomes.plan(runs, own_seeds, on_note=lambda note: warn(f"note: {note}"))
        for runs in outcomes.runs
    }

    # 2. The folder, and the command line that resumes.
    stem = _stem(outcomes.file)
    folder = options.out or new_folder(
        Path("experiments"), (f"{stem}-{n}" for n in itertools.count(1))
    )
    command = command_line(
        ("run", name),
        {
            "--seeds": seeds if own_seeds is not None else None,
            "--jobs": options.jobs,
            "--cores": options.cores,
            "--on": options.on,
            "--scheduler-file": options.scheduler_file,
            "--fresh": options.is_fresh,
            "--out": folder,
            "--no-traces": options.no_traces,
            "--timeout": None if options.timeout is None else f"{options.timeout:g}",
        },
    )
    if (folder / MANIFEST).exists():
        raise ConfigError(f"{folder}: holds another experiment; name a new folder with --out")
    for runs, plan in plans.items():
        # Before the copy is written: it never names other runs than the folder holds.
        if (folder / runs / MANIFEST).exists():
            recorded_in(
                folder / runs,
                manifest_of(
                    plan,
                    traces=not options.no_traces,
                    command=command,
                    metrics=beyond_catalog(metrics[runs]),
                ),
            )
    text = read_regular(outcomes.file)
    try:
        folder.mkdir(parents=True, exist_ok=True)
        write_whole(folder / NAME, text)
    except OSError as error:
        raise SwarmError(f"{folder}: cannot be written: {error.strerror or error}") from error

    # 3. The runs.
    begin = time.monotonic()
    results: dict[str, Results] = {}
    with engine(
        options.jobs,
        options.timeout,
        options.cores,
        on=options.on,
        scheduler_file=options.scheduler_file,
    ) as runner:
        for runs, plan in plans.items():
            warn(f"{runs}: {plan.scenario}, {counted(len(plan.runs), 'run')}")
            results[runs] = do_runs(
                plan,
                folder / runs,
                runner,
                traces=not options.no_traces,
                command=command,
                metrics=metrics[runs],
                is_fresh=options.is_fresh,
            )

    # 4. What they reach, and the exit code.
    findings = judge_all(outcomes, {name: of for name, of in results.items() if of.runs})
    lacking = [f"{runs}: {of.lacking}" for runs, of in results.items() if of.lacking]
    left_out = [left_out_seeds(outcomes, runs, plan.seeds) for runs, plan in plans.items()]
    lacking += [text for text in left_out if text]
    show(findings, ", ".join(lacking), is_json=options.is_json)
    planned = sum(len(plan.runs) for plan in plans.values())
    done = sum(len(of.runs) for of in results.values())
    warn(f"{done} of {counted(planned, 'run')} done after {time_span(time.monotonic() - begin)}")
    warn(f"results: {folder}/ (to judge them again: swarmctl exp check {shlex.quote(str(folder))})")
    faultless = sum(len(of.runs) - len(of.pattern_faults) for of in results.values())
    return exit_code(faultless, is_complete=faultless == planned)


def _stem(file: Path) -> str:
    """The name of a folder of results: `dispersion-outcomes` for dispersion/outcomes.yaml."""
    above = file.absolute().parent.name
    return f"{above}-{file.stem}" if file.stem == "outcomes" and above else file.stem


def check_outcomes(folder: Path, *, must_be_sure: bool, is_json: bool) -> bool:
    """Print whether the runs in the folder of a file of outcomes reach its rows; True if so.

    `must_be_sure`: as the option --sure of `exp check`.
    """
    from swarmd.sim.experiments.outcomes import judged_folder
    from swarmd.sim.experiments.requirements import Verdict

    findings, missing = judged_folder(folder)
    is_passed = not missing and all(
        one.finding.is_sure if must_be_sure else one.finding.verdict is not Verdict.NOT_MET
        for one in findings
    )
    show(findings, missing, is_json=is_json, is_passed=is_passed)
    return is_passed


def show(
    findings: Sequence[OutcomeFinding],
    missing: str,
    *,
    is_json: bool,
    is_passed: bool | None = None,
) -> None:
    """Print a row for each finding, and how many are met. `missing`: what runs are missing."""
    from swarmd.sim.experiments.requirements import Verdict
    from swarmd.sim.experiments.statistics import interval, number

    counts = Counter(one.finding.verdict for one in findings)
    if is_json:
        listed = [one.document() for one in findings]
        passed = not missing and not counts[Verdict.NOT_MET] if is_passed is None else is_passed
        print_json("Check", {"passed": passed, "missing": missing, "requirements": listed})
    else:
        rows = []
        for one in findings:
            finding = one.finding
            remark = f" ({finding.remark})" if finding.remark else ""
            rows.append(
                (
                    one.row.what,
                    finding.requirement.text,
                    finding.variant,
                    number(finding.value),
                    interval(finding.interval),
                    f"{finding.verdict}{remark}",
                    one.row.source,
                )
            )
        print_table(("WHAT", "REQUIREMENT", "RUNS", "VALUE", "95 %", "RESULT", "FROM"), rows)
    if missing:
        warn(f"not complete: {missing}")
    warn_of_few(one.finding.few for one in findings)
    undecided = counts[Verdict.UNDECIDED]
    warn(
        f"{counts[Verdict.MET]} of {counted(len(findings), 'outcome')} met"
        f"{f', {undecided} undecided' if undecided else ''}{' so far' if missing else ''}"
    )
