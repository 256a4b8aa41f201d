"""`swarmctl context`: named sets of network options, of which one is in use."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Any

import click
import msgspec

from swarmd.operator.cli.options import CommonOptions, VerbGroup, common_options, local_options
from swarmd.operator.cli.output import print_json, print_table, warn
from swarmd.operator.texts.values import NOTHING
from swarmd.settings.contexts import (
    ENVIRONMENT,
    Context,
    add_context,
    context_in_use,
    contexts_path,
    load_contexts,
    read_contexts,
    remedy,
    save_contexts,
)

FIELDS = ("swarm", "profile", "interface", "seeds", "config", "identity", "insecure")


def _names(ctx: click.Context, param: click.Parameter, incomplete: str) -> list[str]:
    names = load_contexts(contexts_path()).contexts
    return sorted(name for name in names if name.startswith(incomplete))


_name = click.argument("name", shell_complete=_names)


@click.group(cls=VerbGroup)
def context() -> None:
    """Keep sets of network options by name (contexts); every verb uses the options of one context.

    Options of the command line count most, then the environment ($SWARM, $SWARM_CONFIG), then the
    context. A context that names a swarm is ignored if the command line or the environment names
    another swarm. $SWARM_CONTEXT replaces the context in use.
    """


@context.command()
@_name
@local_options
def use(options: CommonOptions, name: str) -> None:
    """Use the context NAME from now on, in all terminals of this user."""
    path = contexts_path()
    contexts = load_contexts(path).with_use(name)
    save_contexts(path, contexts)
    _show(options, name, contexts.get(name))


@context.command("list")
@local_options
def list_contexts(options: CommonOptions) -> None:
    """List the contexts; `*` marks the one in use.

    If the file has faults: lists the contexts that can be read, names the faults, and ends with 2.
    """
    path = contexts_path()
    found, faults = read_contexts(path)
    contexts = found.contexts
    if faults:
        current = os.environ.get(ENVIRONMENT) or found.use
    else:
        chosen = context_in_use()
        current = chosen[0] if chosen else None
    if options.is_json:
        rows = {name: msgspec.to_builtins(one) for name, one in contexts.items()}
        print_json("Contexts", {"use": current, "contexts": rows, "faults": list(faults)})
    else:
        cells = [
            ("*" if name == current else "", name, *(_cell(getattr(one, key)) for key in FIELDS))
            for name, one in sorted(contexts.items())
        ]
        print_table(("", "NAME", *(key.upper() for key in FIELDS)), cells)
    if faults:
        assert path is not None
        warn(f"error: {'; '.join(faults)}; {remedy(path)}")
        click.get_current_context().exit(2)


@context.command()
@click.argument("name", required=False, shell_complete=_names)
@local_options
def show(options: CommonOptions, name: str | None) -> None:
    """Print the options of the context NAME, or of the one in use."""
    chosen = (name, load_contexts(contexts_path()).get(name)) if name else context_in_use()
    if chosen is None:
        raise click.ClickException("no context is in use; see `swarmctl context use`")
    label, one = chosen
    _show(options, label, one)


@context.command()
@click.argument("name")
@click.option("--use", "is_used", is_flag=True, help="Use it from now on.")
@common_options
def add(options: CommonOptions, name: str, is_used: bool) -> None:
    """Keep the network options of this line as the context NAME, or replace it.

    For example: swarmctl context add meadow --swarm meadow --profile field --interface wlan0 --use
    """
    given = {key: value for key in FIELDS if (value := getattr(options, key, None))}
    if not given:
        raise click.UsageError(f"context add needs options, such as --swarm {name}")
    one = Context(**{key: _kept(value) for key, value in given.items()})
    add_context(name, one, use=is_used)
    _show(options, name, one)


@context.command()
@_name
@local_options
def remove(options: CommonOptions, name: str) -> None:
    """Remove the context NAME; the robots do not notice."""
    path = contexts_path()
    contexts = load_contexts(path)
    save_contexts(path, contexts.without(name))
    if options.is_json:
        print_json("Context", {"name": name, "was_in_use": contexts.use == name})
    elif contexts.use == name:
        click.echo(f"{name} was in use; no context is in use now")


def _show(options: CommonOptions, name: str, one: Context) -> None:
    if options.is_json:
        print_json("Context", {"name": name, **msgspec.to_builtins(one)})
    else:
        click.echo(f"{name}: {_line(one)}")


def _kept(value: Any) -> Any:
    return str(value.absolute()) if isinstance(value, Path) else value


def _line(one: Context) -> str:
    values = ((key, getattr(one, key)) for key in FIELDS)
    return ", ".join(f"{key} {_cell(value)}" for key, value in values if value) or NOTHING


def _cell(value: Any) -> str:
    if value is True:
        return "yes"
    text = " ".join(value) if isinstance(value, tuple) else str(value or "")
    return text or NOTHING
