"""`swarmctl param`: parameters of the patterns that are running."""

from __future__ import annotations

from collections.abc import Mapping

import click

from swarmd.cli.arguments import read_assignments, read_targets, target_options
from swarmd.cli.options import CommonOptions, common_options
from swarmd.cli.output import NOTHING, number, print_json, print_table
from swarmd.cli.report import report_outcome
from swarmd.cli.send import expected_of, known_members, send
from swarmd.core.errors import unknown
from swarmd.core.messages import Member, ParamRequest


@click.group()
def param() -> None:
    """Get or set parameters of running patterns."""


@param.command("get")
@target_options
@click.option("-k", "--key", "keys", multiple=True, metavar="KEY", help="Only this one.")
@common_options
def get_params(
    options: CommonOptions,
    names: tuple[str, ...],
    is_all: bool,
    exclude: tuple[str, ...],
    keys: tuple[str, ...],
) -> None:
    """The parameters in force, and where each comes from; without names of all robots."""
    targets = read_targets("param get", names, is_all, exclude, needed=False)
    with options.operator() as operator:
        view = known_members(operator)
    chosen = {name: view.members[name] for name in targets.select(view.members)}
    _check_keys(keys, chosen)
    if options.is_json:
        print_json("Params", {"robots": {name: _plain(m, keys) for name, m in chosen.items()}})
        return
    rows = [
        (name, _pattern(member), key, number(found["value"]), str(found["source"]))
        for name, member in chosen.items()
        for key, found in _plain(member, keys)["params"].items()
    ]
    print_table(("NAME", "PATTERN", "PARAMETER", "VALUE", "FROM"), rows)
    idle = [name for name, member in chosen.items() if not _plain(member, ())["params"]]
    if idle:
        click.echo(f"# no pattern is running on {', '.join(idle)}")


@param.command("set")
@target_options
@click.option("-p", "params", multiple=True, metavar="KEY=VALUE", help="May be repeated.")
@common_options
def set_params(
    options: CommonOptions,
    names: tuple[str, ...],
    is_all: bool,
    exclude: tuple[str, ...],
    params: tuple[str, ...],
) -> None:
    """Change parameters on TARGETS, as KEY=VALUE words or with -p, until the next run.

    For example: swarmctl param set --all speed=0.15
    """
    words = [*params, *(name for name in names if "=" in name)]
    robots = tuple(name for name in names if "=" not in name)
    if not words:
        raise click.UsageError("param set needs values; add KEY=VALUE, such as speed=0.15")
    values = read_assignments(words)
    targets = read_targets("param set", robots, is_all, exclude, needed=True)
    with options.operator() as operator:
        view = known_members(operator)
        expected = expected_of(view, targets)
        outcome = send(operator, view, ParamRequest, expected, options.timeout, params=values)
    report_outcome(options, "param set", outcome)


def _check_keys(keys: tuple[str, ...], chosen: Mapping[str, Member]) -> None:
    known = {key for member in chosen.values() for key in _plain(member, ())["params"]}
    for key in keys:
        if key not in known:
            raise click.UsageError(unknown("parameter", key, known))


def _plain(member: Member, keys: tuple[str, ...]) -> dict[str, dict[str, dict[str, object]]]:
    params = member.status.params if member.status is not None else {}
    return {
        "params": {
            key: {"value": found.value, "source": found.source}
            for key, found in params.items()
            if not keys or key in keys
        }
    }


def _pattern(member: Member) -> str:
    return (member.status.pattern if member.status is not None else None) or NOTHING
