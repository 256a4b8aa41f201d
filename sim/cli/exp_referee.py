"""`swarmctl exp referee`: a controller of others through the tasks of the suite, in one report."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import count
from pathlib import Path
from typing import TYPE_CHECKING

import click

from swarmd.core.errors import ConfigError, SwarmError
from swarmd.operator.cli.output import print_table, warn
from swarmd.operator.cli.plugin import write_plugin
from swarmd.operator.texts.values import counted
from swarmd.sim.cli.exp_runs import command_line, do_runs, exit_code, jobs_option
from swarmd.sim.cli.options import (
    engine,
    fresh_option,
    need,
    new_folder,
    out_option,
    set_option,
    warn_of_few,
)

if TYPE_CHECKING:
    from swarmd.sim.experiments.referee import Case, Controller, Until
    from swarmd.sim.experiments.sequential import SequentialTest

REPORT = "referee.html"


@click.command(epilog="Example: swarmctl exp referee mine/follower --task doorway --seeds 20")
@click.argument("controller", metavar="CONTROLLER")
@click.option(
    "--task",
    "tasks",
    multiple=True,
    metavar="TASK",
    help="A task of the suite, or the file of one; may be repeated [all that the controller fits].",
)
@click.option(
    "--fault",
    "faults",
    multiple=True,
    metavar="FAULT",
    help="scan_frozen, dead_wheel or radio_mute of one robot; may be repeated [all three].",
)
@click.option(
    "--until",
    "untils",
    multiple=True,
    metavar="REQUIREMENT",
    help="'TASK >= VALUE': run seeds of the task in their order until it is sure whether this holds"
    " for the mean of its metric; may be repeated.",
)
@click.option(
    "--most",
    type=click.IntRange(min=1),
    default=500,
    show_default=True,
    help="With --until: the number of seeds after which it stays undecided.",
)
@set_option
@click.option(
    "--seeds",
    default="20",
    show_default=True,
    metavar="SEEDS",
    help="Number of seeds from 0 on, or the seeds: 500-519, or 3,5,9.",
)
@jobs_option
@fresh_option
@out_option("Folder of the runs and the report; interrupted runs in it resume [runs/referee-N].")
@click.pass_context
def referee(
    ctx: click.Context,
    controller: str,
    tasks: tuple[str, ...],
    faults: tuple[str, ...],
    untils: tuple[str, ...],
    most: int,
    sets: tuple[str, ...],
    seeds: str,
    jobs: int | None,
    is_fresh: bool,
    out: Path | None,
) -> None:
    """Run CONTROLLER in the tasks of the benchmark suite, and write one HTML with the verdicts.

    CONTROLLER is a pattern or mission (a name, a file or a folder), a launch file of ROS 2 nodes or
    its folder, or a network (.onnx, .npz). Its robots run each task that they fit, without a fault
    and with a fault of one robot. The control is the same task with robots that stand. The report,
    OUT/referee.html, has the verdicts, the seeds, and the bits of each run, by which others compare
    their repetition.

    Exit code 0 if every run finished, 3 if some failed, 1 if all failed. A run in which a pattern
    raised an error counts as failed here, and its results are kept.
    """
    # 1. What is run: a plan for each case of each task.
    need("mujoco", "matplotlib")
    from swarmd.sim.experiments import referee as judging
    from swarmd.sim.experiments.manifest import read_manifest, write_whole
    from swarmd.sim.experiments.plan import parse_seeds, parse_sets
    from swarmd.sim.report.referee_report import (
        HEAD,
        Refereed,
        referee_report,
        rows_of,
        sentence_of,
    )
    from swarmd.sim.scenarios.scenariofile import TASKS, task_names

    chosen = judging.controller_of(controller)
    wanted = [judging.parse_until(text) for text in untils]
    names = [t if t.endswith(".yaml") else f"{TASKS}/{t}" for t in tasks] or task_names()
    if len({Path(name).stem for name in names}) < len(names):
        raise ConfigError("a task is given twice, or two files have one name; keep one")
    for one in wanted:
        if one.task not in {Path(name).stem for name in names}:
            raise ConfigError(f"--until {one.text!r}: {one.task} is none of the tasks; add --task")
    parts = [(one.task, one.folder) for one in wanted]
    for one, part in zip(wanted, parts, strict=True):
        if parts.count(part) > 1:
            raise ConfigError(f"--until {one.text!r} is given twice; keep one")
    values = parse_sets(sets)
    folder = out or new_folder(Path("runs"), (f"referee-{n}" for n in count(1)))
    digest = judging.digest_of(chosen, folder.absolute())
    chosen = _with_policy(chosen, folder, digest)
    misfits: list[str] = []
    cases = [
        case
        for name in names
        for case in judging.cases_of(
            name,
            parse_seeds(seeds),
            chosen,
            faults or tuple(judging.FAULTS),
            values,
            misfits.append,
        )
    ]
    misfits = list(dict.fromkeys(misfits))
    for line in misfits:
        warn(line)
    if not cases:
        raise ConfigError(f"{controller} fits none of the tasks; see the lines above")
    tests = [_test_of(one, cases) for one in wanted]

    # 2. The runs.
    command = command_line(
        ("referee", controller),
        {
            "--task": tasks,
            "--fault": faults,
            "--until": untils,
            "--most": most if untils else None,
            "--set": sets,
            "--seeds": seeds,
            "--fresh": is_fresh,
            "--out": folder,
        },
    )
    found = []
    decisions = []
    with engine(jobs, None) as runner:
        for number, case in enumerate(cases, start=1):
            warn(f"{number} of {len(cases)}: {case.task}, {case.case}")
            results = do_runs(
                case.plan,
                folder / case.task / case.case,
                runner,
                traces=False,
                command=command,
                metrics=[case.metric],
                is_fresh=is_fresh,
            )
            found.append((case, results))
            for run, reason in list((results.failures | results.pattern_faults).items())[:1]:
                warn(f"run {run} failed: {reason}")
        for until, test in zip(wanted, tests, strict=True):
            scenario = next(name for name in names if Path(name).stem == until.task)
            case = judging.cases_of(scenario, range(most), chosen, (), values)[0]
            results = do_runs(
                case.plan,
                folder / case.task / until.folder,
                runner,
                traces=False,
                command=command,
                metrics=[case.metric],
                test=test,
                is_fresh=is_fresh,
            )
            decided_bits = judging.bits_of(row["bits"] for row in results.rows)
            decision = judging.Decision(until, test.verdict, test.runs, decided_bits)
            warn(f"{until.text}: {decision.verdict} after {counted(decision.runs, 'seed')}")
            decisions.append(decision)

    # 3. The table, the report and the exit code.
    findings = judging.findings_of(found)
    bits = judging.bits_of([*(one.bits for one in findings), *(one.bits for one in decisions)])
    refereed = Refereed(
        controller=controller,
        digest=digest,
        command=command,
        found=found,
        findings=findings,
        decisions=decisions,
        misfits=misfits,
        folder=folder,
        bits=bits,
    )
    path = folder / REPORT
    manifest = read_manifest(folder / cases[0].task / cases[0].case)
    try:
        write_whole(path, referee_report(refereed, manifest))
    except OSError as error:
        raise SwarmError(f"{path}: cannot be written: {error.strerror or error}") from error
    print_table(HEAD, rows_of(findings))
    warn_of_few(one.runs for one in findings)
    warn(sentence_of(findings))
    warn(f"bits of all runs: {bits}; report: {path}")
    planned = sum(len(case.plan.runs) for case, _ in found)
    faultless = sum(len(results.runs) - len(results.pattern_faults) for _, results in found)
    ctx.exit(exit_code(faultless, is_complete=faultless == planned))


def _with_policy(controller: Controller, folder: Path, digest: str) -> Controller:
    """The controller, whose network has become a pattern in `folder`."""
    from swarmd.sim.experiments.referee import Controller as Made

    if controller.policy is None:
        return controller
    name = "".join(char if char.isalnum() else "_" for char in controller.policy.stem.lower())
    place = (folder / f"policy-{digest}").absolute()
    if not (place / f"{name}.py").exists():
        write_plugin(name, place, "movement", controller.policy)
    return Made(name, place)


def _test_of(until: Until, cases: Sequence[Case]) -> SequentialTest:
    """The test of a requirement; ConfigError before any run for one that cannot be decided."""
    from swarmd.sim.experiments.referee import ALPHA
    from swarmd.sim.experiments.sequential import SequentialTest

    case = next((one for one in cases if one.task == until.task), None)
    if case is None:
        raise ConfigError(f"--until {until.text!r}: the controller does not fit {until.task}")
    metric = case.metric
    return SequentialTest(until.requirement(metric), ALPHA, lambda _: metric)
