"""Options and arguments of verbs: swarm, network, form of the answer, durations, targets."""

from __future__ import annotations

import functools
import os
import re
import time
from collections.abc import Callable, Collection, Iterable, Mapping
from dataclasses import dataclass, replace
from fnmatch import fnmatchcase
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING, Any, Concatenate, ParamSpec, TypeVar, cast

import click

from swarmd.cli import completion
from swarmd.core.errors import unknown
from swarmd.core.keys import is_id
from swarmd.network.exit_codes import NO_TARGET, USAGE

if TYPE_CHECKING:
    from click.shell_completion import CompletionItem

    from swarmd.network.operator.operator import Operator
    from swarmd.network.settings import NetworkSettings
    from swarmd.security.identity import Identity

P = ParamSpec("P")
R = TypeVar("R")

DEFAULT_SWARM = "default"
FILE = click.Path(dir_okay=False, path_type=Path)
FOLDER = click.Path(file_okay=False, path_type=Path)
EXISTING = click.Path(exists=True, path_type=Path)
EXISTING_FILE = click.Path(exists=True, dir_okay=False, path_type=Path)
PROFILES = click.Choice(["dev", "field", "routed"])
FORMS = click.Choice(["table", "json"])

Function = TypeVar("Function", bound=Callable[..., Any])

_GLOB = re.compile(r"[a-z0-9_*?\[\]!-]{1,63}")
_DURATION = re.compile(r"(\d+(?:\.\d+)?)(ms|s|m|h)?")
_UNITS = {"ms": 0.001, "s": 1.0, "m": 60.0, "h": 3600.0, None: 1.0}
_MAX_DURATION = 1e7  # s


class Failure(click.ClickException):
    """An error with its exit code (see `swarmd.network.exit_codes`)."""

    def __init__(self, text: str, exit_code: int) -> None:
        super().__init__(text)
        self.exit_code = exit_code  # type: ignore[misc]  # click declares it for the class


class Duration(click.ParamType[float]):
    """Seconds from `60`, `60s`, `1.5m`, `500ms`, `2h`."""

    name = "duration"

    def convert(
        self, value: object, param: click.Parameter | None, ctx: click.Context | None
    ) -> float:
        """The duration in s, above 0."""
        if isinstance(value, int | float):
            return float(value)
        match = _DURATION.fullmatch(str(value).strip().lower())
        seconds = float(match[1]) * _UNITS[match[2]] if match else 0.0
        if not 0.0 < seconds <= _MAX_DURATION:
            self.fail(
                f"{value!r} is no duration; expected a value such as 60s, 2m or 500ms", param, ctx
            )
        return seconds


@dataclass(frozen=True, slots=True)
class Targets:
    """Names and globs of robots, and labels, less the robots in `exclude`.

    A robot with any of the `labels` is a target. Without names and labels all robots are. Labels
    are known by statuses alone: `swarmd.cli.labels` puts names in their place.
    """

    names: tuple[str, ...] = ()
    exclude: tuple[str, ...] = ()
    labels: tuple[str, ...] = ()

    @property
    def is_whole_swarm(self) -> bool:
        """True if no robot is named, labelled or excluded."""
        return not self.names and not self.exclude and not self.labels

    @property
    def full_names(self) -> tuple[str, ...]:
        """The targets without wildcards; each is a target even if no robot has that name."""
        return tuple(name for name in self.names if is_id(name) and not self._is_excluded(name))

    def select(self, known: Collection[str]) -> tuple[str, ...]:
        """The targets among `known`; Failure if a name or glob, excluded or not, matches no robot.

        Also Failure if there are labels, which names alone do not show.
        """
        if self.labels:
            raise Failure("this verb takes names, not labels; see `swarmctl members`", USAGE)
        for glob in (*self.names, *self.exclude):
            if not any(fnmatchcase(name, glob) for name in known):
                check_known(glob, known)
        return self.matching(known)

    def matching(self, known: Iterable[str]) -> tuple[str, ...]:
        """The targets among `known`; names that match none are ignored."""
        return tuple(
            name
            for name in sorted(known)
            if (self._is_open or any(fnmatchcase(name, glob) for glob in self.names))
            and not self._is_excluded(name)
        )

    @property
    def _is_open(self) -> bool:
        return not self.names and not self.labels

    def _is_excluded(self, name: str) -> bool:
        return any(fnmatchcase(name, glob) for glob in self.exclude)


def read_targets(
    verb: str,
    names: tuple[str, ...],
    is_all: bool,
    exclude: tuple[str, ...],
    labels: tuple[str, ...] = (),
    *,
    is_required: bool,
) -> Targets:
    """The targets of a verb; UsageError if a word is no name or glob, or if they are missing."""
    for glob in (*names, *exclude):
        if not _GLOB.fullmatch(glob):
            raise click.UsageError(
                f"{glob!r} is no robot name; expected a-z, 0-9, _ and -, with * ? [..] as wildcards"
            )
    for label in labels:
        if not is_id(label):
            raise click.UsageError(f"{label!r} is no label; expected a-z, 0-9, _ and -")
    if (names or labels) and is_all:
        raise click.UsageError(f"{verb} takes names and labels, or --all, not both")
    if is_required and not names and not labels and not is_all:
        raise click.UsageError(
            f"{verb} needs targets; add robot names, a glob such as 'tb3-*', -l LABEL, or --all"
        )
    return Targets(names, exclude, labels)


def target_options(function: Function) -> Function:
    """Give a verb the parameters `names`, `is_all`, `exclude` and `labels`."""
    for option in (
        click.option(
            "-l",
            "--label",
            "labels",
            multiple=True,
            metavar="LABEL",
            help="Robots with this label; repeated, with any of them.",
            shell_complete=completion.labels,
        ),
        click.option(
            "--exclude",
            multiple=True,
            metavar="GLOB",
            help="Exclude robots; repeatable.",
            shell_complete=completion.robots,
        ),
        click.option("--all", "is_all", is_flag=True, help="All robots of the swarm."),
        click.argument("names", nargs=-1, metavar="[TARGET]...", shell_complete=completion.robots),
    ):
        function = option(function)
    return function


def takes_targets(*, is_required: bool) -> Callable[[Callable[..., R]], Callable[..., R]]:
    """Give a verb the parameter `targets`."""

    def decorate(function: Callable[..., R]) -> Callable[..., R]:
        @functools.wraps(function)
        def wrapper(
            names: tuple[str, ...],
            is_all: bool,
            exclude: tuple[str, ...],
            labels: tuple[str, ...],
            **kwargs: Any,
        ) -> R:
            verb = click.get_current_context().command_path.partition(" ")[2]
            targets = read_targets(verb, names, is_all, exclude, labels, is_required=is_required)
            return function(targets=targets, **kwargs)

        return target_options(wrapper)

    return decorate


def check_known(name: str, known: Collection[str]) -> None:
    """Failure, with the nearest name, unless the robot is known."""
    if name not in known:
        text = f"{unknown('robot', name, known)}; see `swarmctl members`"
        raise Failure(text, NO_TARGET)


_NETWORK_OPTIONS = (
    click.option(
        "--swarm",
        metavar="NAME",
        help="The swarm's name [$SWARM, or default].",
        shell_complete=completion.swarms,
    ),
    click.option(
        "--config",
        type=FILE,
        metavar="FILE",
        help="swarm.yaml with swarm, profile, interface and seeds [$SWARM_CONFIG].",
    ),
    click.option(
        "--profile",
        type=PROFILES,
        help="dev: robots on this machine; field: robots on --interface; routed: by Zenoh routers.",
    ),
    click.option("--interface", metavar="NAME", help="The network interface, such as wlan0."),
    click.option(
        "--seed",
        "seeds",
        multiple=True,
        metavar="ENDPOINT",
        help="A robot to dial, such as tcp/10.0.0.5:7440; may be repeated.",
    ),
    click.option(
        "--identity",
        type=FOLDER,
        metavar="FOLDER",
        help="Your identity [that of this user or machine for the swarm].",
    ),
    click.option("--insecure", is_flag=True, help="For a swarm without keys."),
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


class LazyGroup(VerbGroup):
    """A group whose verbs are imported when they are used.

    `verbs`: name -> `module:function`, and the line for --help, which must not import the verbs.
    """

    def __init__(self, *args: Any, verbs: Mapping[str, tuple[str, str]], **more: Any) -> None:
        super().__init__(*args, **more)
        self.verbs = verbs

    def summaries(self) -> list[tuple[str, str]]:
        """Each verb with its line for --help."""
        return [(name, text) for name, (_, text) in self.verbs.items()]

    def list_commands(self, ctx: click.Context) -> list[str]:
        """All verbs."""
        return [name for name, _ in self.summaries()]

    def get_command(self, ctx: click.Context, cmd_name: str) -> click.Command | None:
        """The verb of that name, imported; None if it is unknown."""
        if cmd_name not in self.verbs:
            return None
        module, _, attribute = self.verbs[cmd_name][0].partition(":")
        return cast(click.Command, getattr(import_module(module), attribute))

    def format_commands(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        """Write a line for each verb."""
        with formatter.section("Verbs"):
            formatter.write_dl(self.summaries())

    def shell_complete(self, ctx: click.Context, incomplete: str) -> list[CompletionItem]:
        """Offer verbs and options."""
        from click.shell_completion import CompletionItem

        rows = self.summaries()
        found = [
            CompletionItem(name, help=text) for name, text in rows if name.startswith(incomplete)
        ]
        return [*found, *click.Command.shell_complete(self, ctx, incomplete)]


@dataclass(frozen=True, slots=True)
class CommonOptions:
    """The options of every verb; None or empty if not given."""

    swarm: str | None = None
    config: Path | None = None
    profile: str | None = None
    interface: str | None = None
    seeds: tuple[str, ...] = ()
    identity: Path | None = None
    insecure: bool = False
    output: str | None = None
    timeout: float | None = None

    @property
    def is_json(self) -> bool:
        """True if the answer is wanted as JSON."""
        return self.output == "json"

    def in_context(self) -> CommonOptions:
        """These options, and those of the context in use where neither they nor $SWARM set any.

        A swarm file that the line or $SWARM_CONFIG names takes the place of the context. A context
        of one swarm is not used for another swarm. ConfigError if the context does not exist.
        """
        import msgspec

        from swarmd.settings.contexts import context_in_use

        chosen = context_in_use() if self.config is None else None
        if chosen is None:
            return self
        swarm = self.swarm or os.environ.get("SWARM")
        if swarm and chosen[1].swarm not in (None, swarm):
            return self
        given = msgspec.structs.asdict(chosen[1])
        given["swarm"] = swarm or chosen[1].swarm
        for name in ("config", "identity"):
            given[name] = Path(given[name]) if given[name] else None
        return replace(self, **{key: one for key, one in given.items() if not getattr(self, key)})

    def operator(self) -> Operator:
        """A session in the swarm's network, a context manager.

        ConfigError for a wrong file or option, NetworkError if there is no session.
        """
        from swarmd.network.operator.operator import Operator

        settings, roster, identity = self.network()
        if identity is not None:
            from swarmd.cli.output import warn
            from swarmd.texts.keys import own_end

            if text := own_end(identity.name, identity.info.expires, time.time()):
                warn(text)
        return Operator(settings, roster=roster, identity=identity)

    def network(self) -> tuple[NetworkSettings, list[str], Identity | None]:
        """The settings of the network, the robots that they name, and the identity.

        ConfigError for a wrong file or option.
        """
        return self.in_context()._network()

    def _network(self) -> tuple[NetworkSettings, list[str], Identity | None]:
        from swarmd.network.settings import NetworkSettings, Profile
        from swarmd.security.identity import check_asker, choose_identity

        if self.config is not None:
            from swarmd.settings.swarmfile import load_swarm  # YAML, which most commands do without

            overrides = {
                "swarm": self.swarm,
                "profile": self.profile,
                "interface": self.interface,
                "seeds": list(self.seeds) or None,
                "identity": None if self.identity is None else str(self.identity),
                "insecure": self.insecure or None,
            }
            file, identity = load_swarm(self.config, overrides, os.environ)
            check_asker(identity)
            return file, file.roster, identity
        settings = NetworkSettings(
            swarm=self.swarm or os.environ.get("SWARM") or DEFAULT_SWARM,
            profile=cast(Profile, self.profile or "dev"),
            interface=self.interface,
            seeds=self.seeds,
        )
        settings.check()
        identity = choose_identity(settings.swarm, self.identity, insecure=self.insecure)
        check_asker(identity)
        return settings, [], identity


def common_options(function: Callable[Concatenate[CommonOptions, P], R]) -> Callable[..., R]:
    """Give a verb the common options as its first argument; those before the verb are defaults."""
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
        ctx, config = click.get_current_context(), os.environ.get("SWARM_CONFIG")
        above = ctx.find_object(CommonOptions)
        defaults = above or CommonOptions(config=Path(config) if config else None)
        given = {name: kwargs.pop(name, None) for name in CommonOptions.__slots__}
        ctx.obj = replace(defaults, **{name: value for name, value in given.items() if value})
        return function(ctx.obj, *args, **kwargs)

    for option in reversed(options):
        wrapper = option(wrapper)
    return wrapper
