"""`swarmd`: the daemon of one robot. Reads its settings, then serves until a signal ends it."""

from __future__ import annotations

import os
import resource
import sys
from pathlib import Path
from typing import NoReturn

import click

from swarmd.core.errors import ConfigError, DriverError, IdHeldError, NetworkError, SwarmError
from swarmd.core.numbers import read_number
from swarmd.core.processes import die_with_parent as tie_to
from swarmd.core.processes import keep_from_tracing
from swarmd.operator.cli import completion
from swarmd.operator.cli.options import FILE, PROFILES, LazyGroup, LazyVerb
from swarmd.operator.cli.swarmctl import flushed, run_cli
from swarmd.operator.texts.assignments import Value, read_assignments

# Open files: a daemon needs about 40 for itself, and one for each link of an operator.
MIN_DESCRIPTORS = 128
WANTED_DESCRIPTORS = 4096

# Subcommands, which a daemon must not import: its start takes 0.2 s of CPU.
VERBS = {
    "install": LazyVerb(
        "swarmd.operator.cli.install:install", "Take a bundle: this machine becomes its robot."
    ),
    "service": LazyVerb(
        "swarmd.operator.cli.service:service", "Run the daemon as a service of systemd."
    ),
    "stop-base": LazyVerb(
        "swarmd.operator.cli.stop_base:stop_base", "Command zero to the base, and exit."
    ),
    "hub": LazyVerb("swarmd.operator.cli.hub:hub", "Run the hub of a base, 3 s longer than asked."),
}
_EPILOG = """\b
Exit codes:
  0  clean end after a zero command; with --check: no fault found
  1  internal error; with --check: a fault found
  2  configuration or usage; nothing was started
  3  another daemon of this swarm has the same id
  4  no network session
  5  the driver cannot be used on this robot"""


@click.group(
    cls=LazyGroup,
    verbs=VERBS,
    invoke_without_command=True,
    subcommand_metavar="[VERB ...]",
    epilog=_EPILOG,
    context_settings={"help_option_names": ["-h", "--help"]},
)
@click.option(
    "--config",
    type=FILE,
    metavar="FILE",
    help="The daemon's YAML file; the options below override it.",
)
@click.option("--id", metavar="ID", help="The robot's id [the host name].")
@click.option("--swarm", metavar="NAME", help="The swarm's name [$SWARM, or default].")
@click.option(
    "--platform",
    metavar="NAME",
    help="A platform, or a .yaml file [waffle_pi].",
    shell_complete=completion.platforms,
)
@click.option("--driver", metavar="NAME", help="The interface to the base [simulated].")
@click.option(
    "--driver-option",
    "driver_options",
    multiple=True,
    metavar="KEY=VALUE",
    help="An option of the driver; may be repeated.",
)
@click.option(
    "--profile",
    type=PROFILES,
    help="dev: this machine; field: a network; routed: by Zenoh routers.",
)
@click.option("--interface", metavar="NAME", help="The network interface for profile field.")
@click.option("--seed", "seeds", multiple=True, metavar="ENDPOINT", help="A robot to dial.")
@click.option(
    "--identity",
    type=click.Path(file_okay=False),
    metavar="FOLDER",
    help="The robot's identity [that of this user or machine for the swarm].",
)
@click.option("--insecure", is_flag=True, help="Start without keys: anyone may drive the robot.")
@click.option(
    "--state-dir",
    type=click.Path(file_okay=False),
    help="Folder for latches [~/.local/state/swarmd].",
)
@click.option("--plugin-dir", type=click.Path(file_okay=False), help="Folder of one-file patterns.")
@click.option(
    "--log-level",
    type=click.Choice(["debug", "info", "warning"]),
    default="info",
    help="The least level that is logged [info].",
)
@click.option("--die-with-parent", type=int, metavar="PID", hidden=True)
@click.version_option(package_name="swarmd", prog_name="swarmd", message="%(prog)s %(version)s")
@click.option("--check", is_flag=True, help="Check everything, move nothing, and exit.")
@click.option(
    "--print-effective-config", is_flag=True, help="Show each setting with its source, and exit."
)
@click.pass_context
def swarmd(
    ctx: click.Context,
    /,
    config: Path | None,
    log_level: str,
    check: bool,
    print_effective_config: bool,
    driver_options: tuple[str, ...],
    seeds: tuple[str, ...],
    insecure: bool,
    die_with_parent: int | None,
    **options: str | None,  # all other options, by name, such as `id`
) -> None:
    """Drive and protect one robot, and run one pattern in a child process.

    Ends on SIGTERM, SIGINT and SIGHUP: commands zero, leaves the swarm, exit code 0. With a verb,
    such as `install`, the program administers this machine and starts no daemon.
    """
    if ctx.invoked_subcommand is not None:
        _refuse_options(ctx)
        return
    overrides = {  # options that replace values of the file; None: the value of the file counts
        # Empty: not given, as launch files pass an argument without a value.
        **{name: value or None for name, value in options.items()},
        "seeds": list(seeds) or None,
        "insecure": insecure or None,
        "driver_options": _read_options(driver_options) or None,
        "die_with_parent": die_with_parent,
    }
    if die_with_parent is not None:  # the id of the parent process
        tie_to(die_with_parent)
    check_descriptors()  # each link of an operator needs an open file
    # numpy, which is loaded below, would start a BLAS thread per core for arrays of 360 numbers.
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    starts_daemon = not (check or print_effective_config)
    if starts_daemon:
        # Before the settings and keys are read: the forked process, which will run the pattern,
        # must not hold them. `ctx` ends the process when this command ends.
        _fork_host(ctx)
    # After the fork: the pattern host needs no asyncio, which takes 2 MB of each process.
    from swarmd.core.openssl import without_openssl

    with without_openssl():
        import asyncio
    from swarmd.settings.settings import load_daemon_settings

    settings = load_daemon_settings(config, overrides)
    _log_to_stderr(log_level.upper(), settings.id)
    if print_effective_config:
        from swarmd.operator.cli.effective_config import effective_config

        click.echo(effective_config(settings), nl=False)
    elif check:
        from swarmd.operator.cli.preflight import check_daemon

        ctx.exit(check_daemon(settings))
    else:
        from swarmd.daemon.daemon import serve

        # A pattern host is a process of the same user, and must not read the daemon's keys by
        # ptrace. Profile `dev` is exempt: benchmarks and tests read the daemon's memory and files.
        if settings.network.profile != "dev":
            keep_from_tracing()
        ctx.exit(asyncio.run(serve(settings)))


def _fork_host(ctx: click.Context) -> None:
    """Fork the process that will run the pattern, and end it with `ctx`."""
    from swarmd.pattern_host.forked import forked_host

    # Without -P the first folder in `sys.path` is the folder of the program, or with -m the present
    # folder. A file random.py in this folder must not shadow a module.
    path = sys.path if sys.flags.safe_path else sys.path[1:]
    ctx.with_resource(forked_host(path))


def _log_to_stderr(level: str, robot: str) -> None:
    """Log to standard error, without time and level, which the journal of systemd adds."""
    import logging  # after the fork, as asyncio

    from swarmd.daemon.systemd import JournalFormatter, is_journal

    handler = logging.StreamHandler(sys.stderr)
    if is_journal(sys.stderr):
        handler.setFormatter(JournalFormatter(f"{robot} %(name)s: %(message)s"))
    else:
        line = f"%(asctime)s {robot} %(levelname)s %(name)s: %(message)s"
        handler.setFormatter(logging.Formatter(line))
    logging.basicConfig(level=level, handlers=[handler])


def check_descriptors() -> None:
    """Raise this process's limit of open files; ConfigError in one line if it stays too low."""
    soft, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
    if soft < WANTED_DESCRIPTORS:
        soft = (
            WANTED_DESCRIPTORS if hard == resource.RLIM_INFINITY else min(hard, WANTED_DESCRIPTORS)
        )
        resource.setrlimit(resource.RLIMIT_NOFILE, (soft, hard))
    if soft < MIN_DESCRIPTORS:
        raise ConfigError(
            f"this process may open {soft} files; a daemon needs {MIN_DESCRIPTORS}: about 40 for"
            " itself, and one for each link of an operator; raise the limit"
            " (ulimit -n, or LimitNOFILE= of systemd)"
        )


def main(args: list[str] | None = None) -> NoReturn:
    """Run swarmd and exit with its code; every error is one line on stderr."""
    sys.exit(flushed(run_cli(swarmd, args, "swarmd", exit_code_of)))


def exit_code_of(error: SwarmError) -> int:
    """The exit code for an error, for a process supervisor such as systemd; 2 for other errors."""
    codes = {IdHeldError: 3, NetworkError: 4, DriverError: 5}
    return next((code for kind, code in codes.items() if isinstance(error, kind)), 2)


def _refuse_options(ctx: click.Context) -> None:
    """Raise UsageError if a line with a verb has options of the daemon before it."""
    for option in ctx.command.params:
        source = ctx.get_parameter_source(option.name or "")
        if source is click.core.ParameterSource.COMMANDLINE:
            raise click.UsageError(
                f"{option.opts[-1]} is an option of the daemon; options of"
                f" {ctx.invoked_subcommand} follow it",
                ctx,
            )


def _read_options(words: tuple[str, ...]) -> dict[str, Value]:
    """The driver's options; numbers and `true` and `false` are read as in a file."""
    booleans = {"true": True, "false": False}
    found = read_assignments(words, "--driver-option")
    for key, value in found.items():
        if isinstance(value, str):
            number = read_number(value)
            found[key] = booleans.get(value, value) if number is None else number
    return found


if __name__ == "__main__":
    main()
