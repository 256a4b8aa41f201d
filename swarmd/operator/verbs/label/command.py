"""`swarmctl label`: give labels to robots and take them away."""

from __future__ import annotations

import click

from swarmd.core.keys import is_id
from swarmd.core.verbs import LabelRequest
from swarmd.operator.cli import completion
from swarmd.operator.cli.options import CommonOptions, Failure, common_options
from swarmd.operator.cli.send import Asked, asking
from swarmd.operator.cli.targets import takes_targets
from swarmd.operator.session.exit_codes import TIMEOUT
from swarmd.operator.session.outcome import joined
from swarmd.operator.session.targets import Targets, labels_of
from swarmd.operator.verbs.label.ask import change_labels
from swarmd.operator.verbs.label.words import read_changes


class LabelCommand(click.Command):
    """Reads `+red` and `-blue` as `--add red` and `--remove blue`."""

    def parse_args(self, ctx: click.Context, args: list[str]) -> list[str]:
        """Replace the signs by options; one letter after `-` stays an option."""
        words: list[str] = []
        for word in args:
            sign = word[:1]
            label = word[1:]
            is_signed = sign == "+" or (sign == "-" and len(label) > 1 and is_id(label))
            words += ["--add" if sign == "+" else "--remove", label] if is_signed else [word]
        return super().parse_args(ctx, words)


@click.command(cls=LabelCommand)
@takes_targets(is_required=True)
@click.option(
    *("--add", "added"),
    multiple=True,
    metavar="LABEL",
    help="The same as +LABEL.",
    shell_complete=completion.labels,
)
@click.option(
    *("--remove", "removed"),
    multiple=True,
    metavar="LABEL",
    help="The same as -LABEL.",
    shell_complete=completion.labels,
)
@click.option("--reset", is_flag=True, help="Go back to the labels of the robots' swarm file.")
@common_options
def label(
    options: CommonOptions,
    targets: Targets,
    added: tuple[str, ...],
    removed: tuple[str, ...],
    reset: bool,
) -> None:
    """Give TARGETS labels, and take labels away: swarmctl label tb3-01 +red -blue.

    A robot keeps its labels across restarts. `-l LABEL` targets the robots with a label, and the
    swarm file may give parameters to a label. Moves nothing: a robot that gets the label of a goal
    is offered that goal, and `swarmctl resume` runs it.
    """
    changes = [*(f"+{name}" for name in added), *(f"-{name}" for name in removed)]
    is_neither_or_both = bool(changes) == reset
    if is_neither_or_both:
        raise click.UsageError("label needs +LABEL or -LABEL, or --reset alone")
    if changes:
        read_changes(changes)  # a check only: ConfigError for a word that is no label
    with asking(options, targets, needs_status=True) as asked:
        if reset:  # `labels` None: those of the swarm file
            outcome = joined([asked.targeted.request(LabelRequest, labels=None)])
        else:
            _check_labels_known(asked)
            outcome = change_labels(asked.targeted, added, removed)
        asked.report(outcome)


def _check_labels_known(asked: Asked) -> None:
    """Failure if the present labels of a target are not known.

    A request replaces all labels of a robot, so the labels that stay must be known.
    """
    known_labels = labels_of(asked.view)
    unknown_robots = [name for name in asked.names if name not in known_labels]
    if unknown_robots:
        names = ", ".join(unknown_robots)
        raise Failure(f"the labels of {names} are not known; nothing was sent", TIMEOUT)
