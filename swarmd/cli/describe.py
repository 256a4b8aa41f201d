"""`swarmctl describe`: the whole status of one robot, and why it does not move."""

from __future__ import annotations

import time

import click
from msgspec import to_builtins

from swarmd.cli import completion
from swarmd.cli.arguments import check_known
from swarmd.cli.options import CommonOptions, common_options
from swarmd.cli.output import print_json, print_section
from swarmd.cli.send import exit_code_of, known_members
from swarmd.texts.keys import key_warnings
from swarmd.texts.status import sections
from swarmd.texts.values import printable
from swarmd.texts.why import why


@click.command()
@click.argument("robot", shell_complete=completion.robots)
@common_options
def describe(options: CommonOptions, robot: str) -> None:
    """Print the whole status of ROBOT, and why it does not move."""
    with options.operator() as operator:
        view = known_members(options, operator)
        check_known(robot, view.members)
        member = view.members[robot]
        if options.is_json:
            print_json("Member", {"member": to_builtins(member), "why": why(member)})
        else:
            click.echo(printable(f"{robot}: {why(member)}"))
            if member.status is not None:
                for note in key_warnings([member.status], time.time()):
                    click.echo(note)
                for title, rows in sections(member, member.status):
                    print_section(title, rows)
        click.get_current_context().exit(exit_code_of(view, [robot]))
