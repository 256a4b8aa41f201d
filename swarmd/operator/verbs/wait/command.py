"""`swarmctl wait`: wait until robots are as they are wanted."""

from __future__ import annotations

import click

from swarmd.operator.cli.options import CommonOptions, Failure, common_options
from swarmd.operator.cli.output import print_json
from swarmd.operator.cli.send import session_of
from swarmd.operator.cli.targets import takes_targets
from swarmd.operator.session.exit_codes import APPLIED, TIMEOUT
from swarmd.operator.session.targets import Targets
from swarmd.operator.verbs.wait.ask import wait_for
from swarmd.operator.verbs.wait.words import read_awaited


@click.command()
@takes_targets(is_required=False)
@click.option(
    "--for",
    "wanted",
    multiple=True,
    required=True,
    metavar="CONDITION",
    help="state=STATE, pattern=PATTERN, presence=PRESENCE, goal, count=NUMBER, or count=alive;"
    " repeated: all.",
)
@common_options
def wait(options: CommonOptions, targets: Targets, wanted: tuple[str, ...]) -> None:
    """Wait until TARGETS, or all robots, meet each condition; at most --timeout, or 30 s.

    goal: each robot does what its goal wants. count=5: at least five robots are alive and meet all
    other conditions. count=alive: all robots that are alive meet them, without those that are off
    or out of reach. Robots of the roster and named robots are waited for even if they are not
    heard yet. The exit code is 5 if the time ends before all conditions are met.
    """
    conditions = read_awaited(wanted)
    with options.operator() as operator:
        done = wait_for(session_of(options, operator), targets, conditions)
        names = list(done.names)
        met = list(done.met)
        missing = dict(done.missing)
        if options.is_json:
            code = TIMEOUT if missing else APPLIED
            content = {"robots": names, "met": met, "missing": missing, "exit_code": code}
            print_json("Wait", content)
        if missing:
            raise Failure(done.text, TIMEOUT)
        if not options.is_json:
            others = ", ".join(name for name in names if name not in met)
            click.echo(f"{', '.join(met)}: as wanted{f'; not: {others}' if others else ''}")
