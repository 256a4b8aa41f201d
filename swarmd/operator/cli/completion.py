"""`swarmctl completion`: scripts for the shells, and the values that Tab offers.

A function that offers values gets the context of the line that the user types. Standard error is
discarded meanwhile, since the shell would show its text in that line (see `run_cli`).
"""

from __future__ import annotations

import os
from collections.abc import Iterable
from dataclasses import fields
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

if TYPE_CHECKING:
    from click.shell_completion import CompletionItem

    from swarmd.operator.cli.options import CommonOptions

SHELLS = ("bash", "zsh", "fish")


@click.command()
@click.argument("shell", type=click.Choice(SHELLS))
def completion(shell: str) -> None:
    """Print a script that lets SHELL complete verbs, options, robots and patterns with Tab.

    \b
    bash: eval "$(swarmctl completion bash)" in ~/.bashrc
    zsh:  eval "$(swarmctl completion zsh)" in ~/.zshrc, after compinit
    fish: swarmctl completion fish > ~/.config/fish/completions/swarmctl.fish
    """
    from click.shell_completion import get_completion_class

    found = get_completion_class(shell)
    assert found is not None
    for name in ("swarmctl", "swarmd"):
        click.echo(found(click.Command(name), {}, name, f"_{name.upper()}_COMPLETE").source())


def robots(ctx: click.Context, param: click.Parameter, incomplete: str) -> list[str]:
    """The robots of the swarm that the line names, less those that it has already."""
    from swarmd.operator.session.targets import known_names

    given = ctx.params.get(param.name or "") or ()
    with _options(ctx).operator() as operator:
        names = known_names(operator)
    return [name for name in names if name.startswith(incomplete) and name not in given]


def labels(ctx: click.Context, param: click.Parameter, incomplete: str) -> list[str]:
    """The labels of robots that the last looks at the swarm have found."""
    from swarmd.operator.session.targets import known_labels

    given = ctx.params.get(param.name or "") or ()
    with _options(ctx).operator() as operator:
        names = known_labels(operator.settings)
    return [name for name in names if name.startswith(incomplete) and name not in given]


def swarms(ctx: click.Context, param: click.Parameter, incomplete: str) -> list[str]:
    """The swarms that were looked at on this machine."""
    from swarmd.core.files import cache_folder

    files = cache_folder().glob("members-*.json")
    names = {path.stem.split("-", 2)[2] for path in files}
    return sorted(name for name in names if name.startswith(incomplete))


def patterns(ctx: click.Context, param: click.Parameter, incomplete: str) -> list[str]:
    """The patterns that are installed here."""
    from swarmd.plugins import pattern_names

    names = pattern_names(ctx.params.get("plugin_dir"))
    return [name for name in names if name.startswith(incomplete)]


def patterns_or_files(
    ctx: click.Context, param: click.Parameter, incomplete: str
) -> list[CompletionItem]:
    """The patterns that are installed here, else files: a pattern may be given by its path."""
    return names_or_files(patterns(ctx, param, ""), incomplete)


def platforms(ctx: click.Context, param: click.Parameter, incomplete: str) -> list[CompletionItem]:
    """The platforms by name, else files."""
    from swarmd.settings.platforms import platform_names

    return names_or_files(platform_names(), incomplete)


def names_or_files(names: Iterable[str], incomplete: str) -> list[CompletionItem]:
    """The names that begin so; files if there are none."""
    from click.shell_completion import CompletionItem

    items = [CompletionItem(name) for name in names if name.startswith(incomplete)]
    return items or [CompletionItem(incomplete, type="file")]


def _options(ctx: click.Context) -> CommonOptions:
    """The options of the line, of the verb before those of swarmctl."""
    from swarmd.operator.cli.options import CommonOptions

    given: dict[str, Any] = {}
    above: click.Context | None = ctx
    while above is not None:
        for field in fields(CommonOptions):
            if value := above.params.get(field.name):
                given.setdefault(field.name, value)
        above = above.parent
    if config := os.environ.get("SWARM_CONFIG"):
        given.setdefault("config", Path(config))
    return CommonOptions(**given)
