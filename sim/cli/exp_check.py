"""`swarmctl exp check`: does an experiment meet requirements."""

from __future__ import annotations

import click

from swarmd.cli.output import print_json, print_table, warn
from swarmd.sim.cli.options import output_option

MISSED = 1  # exit code


@click.command()
@click.argument("experiment", metavar="DIR")
@click.argument("requirements", metavar="REQUIREMENT..", nargs=-1, required=True)
@output_option
@click.pass_context
def check(
    ctx: click.Context, experiment: str, requirements: tuple[str, ...], is_json: bool
) -> None:
    """Check whether the experiment in DIR, or DIR:VARIANT of a sweep, meets requirements.

    A requirement is 'METRIC >= VALUE' in quotes, and means the mean of all runs. 'median(METRIC)',
    'min(METRIC)' and 'max(METRIC)' mean other statistics, and 'runs' the number of runs.
    Comparisons are >= <= > < ==. Every variant of a sweep must meet each requirement.

    Exit code 0 if all are met and every planned run is there, else 1.
    """
    from swarmd.sim.experiments import requirements as checking
    from swarmd.sim.experiments.compare import sides_of
    from swarmd.sim.experiments.report import NOTHING, interval, number

    wanted = [checking.parse_requirement(text) for text in requirements]
    sides = sides_of(experiment)
    found = [checking.check(one, side) for side in sides for one in wanted]
    lacking = checking.missing_runs(sides)
    is_passed = not lacking and all(one.is_met for one in found)
    if is_json:
        rows = [one.document() for one in found]
        print_json("Check", {"passed": is_passed, "missing": lacking, "requirements": rows})
    else:
        table = [
            (
                one.requirement.text,
                one.variant or NOTHING,
                number(one.value),
                interval(one.interval),
                "met" if one.is_met else " ".join(["missed", one.remark and f"({one.remark})"]),
            )
            for one in found
        ]
        print_table(("REQUIREMENT", "VARIANT", "VALUE", "95 %", "RESULT"), table)
    if lacking:
        warn(f"not complete: {lacking}")
    warn(f"{sum(one.is_met for one in found)} of {len(found)} requirements are met")
    ctx.exit(0 if is_passed else MISSED)
