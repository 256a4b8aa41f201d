"""Options and arguments of verbs: swarm, network, form of the answer, durations."""

from __future__ import annotations

import functools
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, fields, replace
from functools import partial
from importlib import import_module
from itertools import groupby
from pathlib import Path
from typing import TYPE_CHECKING, Any, Concatenate, NamedTuple, cast

import click

from swarmd.core.clock import boottime
from swarmd.core.errors import ConfigError, P, R, unknown
from swarmd.core.numbers import read_duration
from swarmd.operator.cli import completion
from swarmd.operator.client.network_options import NetworkOptions

if TYPE_CHECKING:
    from click.shell_completion import CompletionItem

    from swarmd.operator.session.operator import Operator


FILE = click.Path(dir_okay=False, path_type=Path)
FOLDER = click.Path(file_okay=False, path_type=Path)
EXISTING = click.Path(exists=True, path_type=Path)
EXISTING_FILE = click.Path(exists=True, dir_okay=False, path_type=Path)
FORMS = click.Choice(["table", "json"])

_MAX_DURATION = 1e7  # s


class _Choice(click.Choice[str]):
    """A choice that takes an empty value as not given, as launch files pass it."""

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Any:
        """The value, or None for an empty one."""
        return super().convert(value, param, ctx) if value else None


PROFILES = _Choice(["dev", "field", "routed"])


class Failure(click.ClickException):
    """An error with its exit code (see `swarmd.operator.session.exit_codes`)."""

    def __init__(self, text: str, exit_code: int) -> None:
        super().__init__(text)
        self.exit_code = exit_code  # type: ignore[misc]  # click declares it for the class


class _PluginFolder(click.Path):
    """A folder that exists; a file is refused with the name of its folder."""

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Any:
        """The path of the folder; ConfigError if the one of the variable is not there."""
        is_of_variable = (
            ctx is not None
            and param is not None
            and param.name is not None
            and ctx.get_parameter_source(param.name) is click.core.ParameterSource.ENVIRONMENT
        )
        if is_of_variable and not Path(value).is_dir():
            raise ConfigError(
                f"$SWARM_PLUGIN_DIR is {str(value)!r}, which is no folder; set it to the folder of"
                " your patterns, or unset it"
            )
        if Path(value).is_file():
            self.fail(f"{value} is a file; name its folder, {Path(value).parent}", param, ctx)
        return super().convert(value, param, ctx)


plugin_dir_option = click.option(
    "--plugin-dir",
    type=_PluginFolder(exists=True, file_okay=False, path_type=Path),
    envvar="SWARM_PLUGIN_DIR",
    help="Folder of one-file patterns, in addition to the installed ones [$SWARM_PLUGIN_DIR].",
)


class Duration(click.ParamType[float]):
    """Seconds from `60`, `60s`, `1.5m`, `3min`, `500ms`, `2h`."""

    name = "duration"

    def convert(
        self, value: object, param: click.Parameter | None, ctx: click.Context | None
    ) -> float:
        """The duration in s, above 0."""
        if isinstance(value, int | float):
            return float(value)
        seconds = read_duration(str(value)) or 0.0
        if not 0.0 < seconds <= _MAX_DURATION:
            self.fail(
                f"{value!r} is no duration; expected a value such as 60s, 2m or 500ms", param, ctx
            )
        return seconds


class NetworkOption(click.Option):
    """An option of the network; `swarmctl --help` explains it, and a verb's help only names it."""

    def get_help_record(self, ctx: click.Context) -> tuple[str, str] | None:
        """The option with its meaning; in a verb's help all of them in the row of the first."""
        if ctx.parent is None:
            return super().get_help_record(ctx)
        options = [one for one in ctx.command.params if isinstance(one, NetworkOption)]
        if self is not options[0]:
            return None
        return ", ".join(one.opts[0] for one in options), "The network; see `swarmctl --help`."


_network_option = partial(click.option, cls=NetworkOption)
_NETWORK_OPTIONS = (
    _network_option(
        "--swarm",
        metavar="NAME",
        help="The swarm's name [$SWARM, or default].",
        shell_complete=completion.swarms,
    ),
    _network_option(
        "--config",
        type=FILE,
        metavar="FILE",
        help="swarm.yaml with swarm, profile, interface and seeds [$SWARM_CONFIG].",
    ),
    _network_option(
        "--profile",
        type=PROFILES,
        help="dev: robots on this machine; field: robots on --interface; routed: by Zenoh routers.",
    ),
    _network_option("--interface", metavar="NAME", help="The network interface, such as wlan0."),
    _network_option(
        "--seed",
        "seeds",
        multiple=True,
        metavar="ENDPOINT",
        help="A robot to dial, such as tcp/10.0.0.5:7440; may be repeated.",
    ),
    _network_option(
        "--identity",
        type=FOLDER,
        metavar="FOLDER",
        help="Your identity [that of this user or machine for the swarm].",
    ),
    _network_option("--insecure", is_flag=True, help="For a swarm without keys."),
)
output_option = click.option("-o", "--output", type=FORMS, help="Form of the answer [table].")
_LOCAL_OPTIONS = (
    output_option,
    click.option(
        "--timeout", type=Duration(), help="How long the verb may wait for answers, such as 3s."
    ),
)

recordings_argument = click.argument(
    "files", nargs=-1, required=True, metavar="FILE...", type=EXISTING
)
root_option = click.option(
    "--root",
    type=FOLDER,
    metavar="DIR",
    help="The root of another file system, such as that of an SD card.",
)


class VerbGroup(click.Group):
    """A group of verbs: an unknown verb is refused with the nearest; help shows whole lines."""

    def resolve_command(
        self, ctx: click.Context, args: list[str]
    ) -> tuple[str | None, click.Command | None, list[str]]:
        """The verb; raises UsageError with the nearest name if it is unknown."""
        name = args[0]
        if not name.startswith("-") and self.get_command(ctx, name) is None:
            ctx.fail(unknown("verb", name, self.list_commands(ctx)))
        return super().resolve_command(ctx, args)

    def format_commands(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        """Write the first sentence of each verb, not cut short as click does."""
        rows = [
            (name, command.get_short_help_str(limit=300)) for name, command in self.commands.items()
        ]
        with formatter.section("Verbs"):
            formatter.write_dl(rows)


def check_names_or_all(verb: str, names: tuple[str, ...], is_all: bool) -> None:
    """UsageError unless the line has either names or --all."""
    has_names = bool(names)
    if has_names == is_all:  # both, or neither
        raise click.UsageError(f"{verb} needs names or --all")


class LazyVerb(NamedTuple):
    """A verb of the command line that is imported when it is used.

    `place`: `module:function`. `text`: the line of --help, which must not import the verb.
    `section`: the title above that line in --help. `example`: the last line of the verb's own help.
    """

    place: str
    text: str
    section: str = "Verbs"
    example: str = ""


class LazyGroup(VerbGroup):
    """A group whose verbs are imported when they are used."""

    def __init__(self, *args: Any, verbs: Mapping[str, LazyVerb], **more: Any) -> None:
        super().__init__(*args, **more)
        self.verbs = verbs

    def all_verbs(self) -> Mapping[str, LazyVerb]:
        """All verbs by name, grouped by section."""
        return self.verbs

    def list_commands(self, ctx: click.Context) -> list[str]:
        """All verbs."""
        return list(self.all_verbs())

    def get_command(self, ctx: click.Context, cmd_name: str) -> click.Command | None:
        """The verb of that name, imported; None if it is unknown."""
        if cmd_name not in self.verbs:
            return None
        verb = self.verbs[cmd_name]
        module, _, attribute = verb.place.partition(":")
        command = cast(click.Command, getattr(import_module(module), attribute))
        if verb.example:
            command.epilog = f"\b\nExample:\n  {verb.example}"
        return command

    def format_commands(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        """Write a line for each verb, by sections."""
        for section, some in groupby(self.all_verbs().items(), lambda item: item[1].section):
            with formatter.section(section):
                formatter.write_dl([(name.ljust(10), verb.text) for name, verb in some])

    def shell_complete(self, ctx: click.Context, incomplete: str) -> list[CompletionItem]:
        """Offer verbs and options."""
        from click.shell_completion import CompletionItem

        rows = self.all_verbs().items()
        found = [
            CompletionItem(name, help=one.text) for name, one in rows if name.startswith(incomplete)
        ]
        return [*found, *click.Command.shell_complete(self, ctx, incomplete)]


@dataclass(frozen=True, slots=True)
class CommonOptions(NetworkOptions):
    """The common options of every verb; None or empty if not given.

    These are no options: `began`: when the user typed the command, in s on the clock since boot.
    `is_program`: the command line is that of this process, which may begin again with it.
    """

    output: str | None = None
    timeout: float | None = None
    began: float = field(default_factory=boottime, compare=False)
    is_program: bool = field(default=False, compare=False)

    @property
    def is_json(self) -> bool:
        """True if the answer must be JSON."""
        return self.output == "json"

    def operator(
        self, tell: Callable[[str], object] | None = None, *, needs_file: bool = True
    ) -> Operator:
        """A session in the swarm's network; lines for the user are warnings without `tell`."""
        from swarmd.operator.cli.output import warn

        return NetworkOptions.operator(self, tell or warn, needs_file=needs_file)


def common_options(function: Callable[Concatenate[CommonOptions, P], R]) -> Callable[..., R]:
    """Give a verb the common options as first argument; options before the verb are defaults."""
    return _with_options(function, (*_NETWORK_OPTIONS, *_LOCAL_OPTIONS))


def local_options(function: Callable[Concatenate[CommonOptions, P], R]) -> Callable[..., R]:
    """As `common_options`, for a verb that uses no network."""
    return _with_options(function, _LOCAL_OPTIONS)


def _with_options(
    function: Callable[Concatenate[CommonOptions, P], R],
    options: tuple[Callable[[Callable[..., R]], Callable[..., R]], ...],
) -> Callable[..., R]:

    @functools.wraps(function)
    def wrapper(*args: Any, **kwargs: Any) -> R:
        ctx = click.get_current_context()
        defaults = ctx.find_object(CommonOptions) or CommonOptions.of_environment()
        given = {one.name: kwargs.pop(one.name, None) for one in fields(CommonOptions)}
        ctx.obj = replace(defaults, **{name: value for name, value in given.items() if value})
        return function(ctx.obj, *args, **kwargs)

    for option in reversed(options):
        wrapper = option(wrapper)
    return wrapper
