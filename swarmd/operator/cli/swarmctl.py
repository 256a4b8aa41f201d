"""`swarmctl`: the operator's command line.

A verb is imported when it is used. Verbs of plugins are searched only if the core has no verb of
that name, and for `--help`: reading the metadata of installed packages takes 40 ms and more.
"""

from __future__ import annotations

import contextlib
import os
import signal
import sys
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from typing import Any, NoReturn

import click

from swarmd.core.clock import boottime, process_start
from swarmd.core.errors import (
    ConfigError,
    NetworkError,
    PluginError,
    RequestError,
    SwarmError,
)
from swarmd.core.files import as_text
from swarmd.operator.cli.options import (
    CommonOptions,
    LazyGroup,
    LazyVerb,
    common_options,
    output_option,
)
from swarmd.operator.cli.output import print_json, warn

LOOK = "Look at robots"
MOVE = "Command robots"
FILES = "A swarm file"
OWN = "Patterns of your own"
RECORD = "Measure and record"
HERE = "This machine"
PLUGINS = "Simulate, and verbs of other plugins"
EXIT_CODES_HELP = """\b
Exit codes:
  0  all targeted robots applied it
  1  none applied it, and at least one failed
  2  usage, or all that answered know no such pattern or parameter: none moved
  3  partial: some robots applied it, some did not; of a look: some did not answer
  4  no robot was targeted
  5  none applied it or failed, and at least one did not answer in time
  6  no daemon could be reached
  7  all robots refused
  130  interrupted
  141  the reader of the output has ended, such as head"""
CLOSED_PIPE = 141
"""The exit code of a program that SIGPIPE ends."""
STDERR = 2  # file descriptor


def _verb(
    name: str, section: str, example: str, text: str, file: str = "", *, folder: str = ""
) -> tuple[str, LazyVerb]:
    """A verb by name; `text`: its line of --help.

    `folder`: its folder in `swarmd/operator/verbs`; without one, `file` is its module in
    `swarmd/operator/cli`, by default its name.
    """
    module = f"verbs.{folder}.command" if folder else f"cli.{file or name}"
    place = f"swarmd.operator.{module}:{name}"
    return name, LazyVerb(place, text, section, f"swarmctl {name} {example}".rstrip())


# fmt: off
VERBS = dict((
    _verb("members", LOOK, "--wide", "List the robots of the swarm and their states.",
          folder="members"),
    _verb("describe", LOOK, "tb3-03",
          "Show one robot in detail, and why it does not move.",
          folder="members"),
    _verb("goal", LOOK, "", "Show what robots are to do beside what they do.",
          folder="goal"),
    _verb("events", LOOK, "-f", "Print what happened to robots, and follow it.",
          folder="events"),
    _verb("view", LOOK, "--web", "Show a living swarm: map, list, details and commands."),
    _verb("doctor", LOOK, "--all", "Check this machine and robots; print what to do.",
          folder="doctor"),
    _verb("links", LOOK, "", "Show which robots hear which, and how well."),
    _verb("logs", LOOK, "tb3-03 -f", "Print the logs of robots and what patterns print."),
    _verb("audit", LOOK, "--since 1h", "Print the requests that robots had, and their answers."),
    _verb("zenoh", LOOK, "--out meadow.json5",
          "Print the configuration with which any Zenoh program reads the swarm."),
    _verb("run", MOVE, "attraction 'tb3-[01-04]' -p speed=0.1 --for 60s",
          "Start a pattern on robots.", folder="run"),
    _verb("stop", MOVE, "", "Stop robots, or all robots.", folder="stop"),
    _verb("estop", MOVE, "--reason 'a person in the arena'",
          "Emergency-stop robots, or all robots; latched.", folder="stop"),
    _verb("reset", MOVE, "--all",
          "Clear emergency stops and faults; moves nothing.", folder="stop"),
    _verb("drive", MOVE, "tb3-03",
          "Drive one robot by hand, with the keys of a terminal.", folder="drive"),
    _verb("param", MOVE, "set --all speed=0.2", "Get or set parameters of running patterns.",
          folder="param"),
    _verb("resume", MOVE, "tb3-07", "Let robots take up the goal that they were offered.",
          folder="goal"),
    _verb("undo", MOVE, "", "Set the goal before the present one again.",
          folder="goal"),
    _verb("wait", MOVE, "--all --for state=running", "Wait until robots are as they are wanted.",
          folder="wait"),
    _verb("label", MOVE, "tb3-01 tb3-02 +red", "Give labels to robots, and take them away.",
          folder="label"),
    _verb("diff", FILES, "swarm.yaml", "Show what a swarm file would change.",
          folder="apply"),
    _verb("apply", FILES, "swarm.yaml", "Set labels, goal and parameters of a swarm file.",
          folder="apply"),
    _verb("patterns", OWN, "show attraction", "List patterns and their parameters."),
    _verb("plugin", OWN, "new swirl",
          "Write, check and reload patterns of your own, and push them to robots."),
    _verb("mission", OWN, "check patrol.yaml", "Check a mission before robots run it.", "patterns"),
    _verb("record", RECORD, "start --all", "Record robots, and fetch their recordings.",
          folder="record"),
    _verb("incidents", RECORD, "fetch 3fa2",
          "List what went wrong, fetch the last minute of all robots, or mark an incident.",
          folder="incidents"),
    _verb("replay", RECORD, "tb3-01.mcap",
          "Repeat a recorded run without a robot, and compare its commands."),
    _verb("calibrate", RECORD, "tb3-01 --floor 2.5",
          "Measure brakes, delays and scales of a robot by a few short drives."),
    _verb("acceptance", RECORD, "tb3-01",
          "Guide through the acceptance test of one robot; one file remains.",
          folder="acceptance"),
    _verb("keys", HERE, "init meadow --robots 'tb3-[01-07]'",
          "Make, hand out, renew and revoke the keys of a swarm."),
    _verb("context", HERE, "use lab", "Keep network options by name, and use one set of them."),
    _verb("completion", HERE, "bash",
          "Print the script that completes lines with Tab in bash, zsh or fish."),
))
# fmt: on
"""The verbs that come with swarmd, as `swarmctl --help` shows them: those of a section together."""


class Verbs(LazyGroup):
    """The verbs: first those of the core, then those of plugins."""

    def all_verbs(self) -> Mapping[str, LazyVerb]:
        """All verbs by name."""
        from swarmd import plugins

        lines = plugins.command_summaries().items()
        added = {name: LazyVerb("", text, PLUGINS) for name, text in lines if name not in VERBS}
        return {**VERBS, **added}

    def get_command(self, ctx: click.Context, cmd_name: str) -> click.Command | None:
        """The verb of that name, imported; None if it is unknown."""
        cmd_name = "incidents" if cmd_name == "incident" else cmd_name  # `incident mark`
        if (command := super().get_command(ctx, cmd_name)) is not None:
            return command
        from swarmd import plugins

        if cmd_name not in plugins.command_names():
            return None
        try:
            return plugins.load_command(cmd_name)
        except PluginError as error:
            raise click.ClickException(str(error)) from error

    def invoke(self, ctx: click.Context) -> Any:
        """Run the verb; if a plugin lacks a library, the error has the command to install it.

        If the line of a stop has a mistake, the error first says that no stop was sent.
        """
        try:
            return super().invoke(ctx)
        except click.UsageError as error:
            if not _is_stop(ctx.invoked_subcommand or ""):
                raise
            text = f"nothing was sent and no robot stops: {error.format_message()}"
            raise click.UsageError(text, error.ctx) from error
        except ModuleNotFoundError as error:
            verb = ctx.invoked_subcommand
            missing = error.name
            if verb is None or verb in VERBS or not missing or missing.startswith("swarmd"):
                raise
            from swarmd import plugins

            raise click.ClickException(plugins.how_to_install(missing, verb)) from error


@click.group(
    cls=Verbs,
    verbs=VERBS,
    epilog=EXIT_CODES_HELP,
    context_settings={"help_option_names": ["-h", "--help"]},
)
@click.version_option(package_name="swarmd", prog_name="swarmctl", message="%(prog)s %(version)s")
@common_options
def cli(options: CommonOptions) -> None:
    """Command a swarm of robots from any machine in its network.

    Targets are robot names, globs such as 'tb3-*' and ranges such as 'tb3-[01-07]' (quoted), or
    --all, less --exclude GLOB. `swarmctl help VERB` explains a verb.
    """


_FORK_SERVER = "swarmd.core.fork_server"


def _typed_at() -> float:
    """When the user typed the command, or a script came to it, in s on the clock of `boottime`.

    A shell becomes its last command, as in `sh -c 'swarmctl stop; swarmctl run drive --all'`: the
    process of that command is as old as the shell. The shell has waited for earlier commands, and
    the command has waited for none yet.
    """
    try:
        import resource  # not on Windows
    except ImportError:
        return process_start()
    has_been_shell = resource.getrusage(resource.RUSAGE_CHILDREN).ru_minflt > 0
    return boottime() if has_been_shell else process_start()


def main(args: list[str] | None = None) -> NoReturn:
    """Run swarmctl and exit with its code; every error is one line on stderr."""
    is_fork = _FORK_SERVER in sys.modules  # of a process that may have a server, which goes on
    try:
        options = replace(
            CommonOptions.of_environment(), began=_typed_at(), is_program=args is None
        )
        code = run_cli(cli, args, "swarmctl", exit_code_of, options)
    except SystemExit as end:  # a signal ended the command
        code = end.code if isinstance(end.code, int) else 1
    code = flushed(code)
    if "zenoh" in sys.modules:
        # A session that is still dialling takes seconds to close, and a thread of Zenoh that calls
        # into an interpreter which ends aborts the process. The answer is out.
        if not is_fork and (fork_server := sys.modules.get(_FORK_SERVER)) is not None:
            fork_server.remove_folder()
        os._exit(code)
    sys.exit(code)


def flushed(code: int) -> int:
    """Write buffered output, and return the exit code of a program whose command gave `code`.

    A `code` of 0 becomes CLOSED_PIPE if the reader has gone, and 1 for another error such as a full
    disk. Output that cannot be written is discarded, also after an error. Else Python would try
    again at the end of the process, and fail with exit code 120.
    """
    for stream in (sys.stdout, sys.stderr):
        try:
            stream.flush()
        except AttributeError:  # it was closed before the start
            continue
        except OSError as error:
            code = code or (CLOSED_PIPE if isinstance(error, BrokenPipeError) else 1)
            _discard_output(stream.fileno())
    return code


def run_cli(
    command: click.Command,
    args: list[str] | None,
    name: str,
    code_of: Callable[[SwarmError], int],
    options: CommonOptions | None = None,
) -> int:
    """Run the command of a program and return its exit code; an error is one line on stderr.

    `args`: the words of the command line, None for those of this process. `name`: the program.
    `code_of`: the exit code of an error of swarmd. `options`: the defaults of the options. With
    `-o json` an error is also a JSON document on stdout, the only document.
    """
    words = sys.argv[1:] if args is None else args
    if words[:1] == ["help"]:
        words = [*words[1:], "--help"]
    stdout_at_start = sys.stdout
    is_completing = bool(os.environ.get(f"_{name.upper()}_COMPLETE"))
    if is_completing:  # the shell would show the text of stderr in the line that it completes
        _discard_output(STDERR)
    elif fault := _not_text(words):
        return _fail(fault, 2, words)
    try:
        return int(command.main(words, prog_name=name, standalone_mode=False, obj=options) or 0)
    except click.Abort:
        return _fail("interrupted", 130, words)
    except click.exceptions.NoArgsIsHelpError as error:
        click.echo(error.format_message(), err=True)
        return error.exit_code
    except click.UsageError as error:
        where = error.ctx.command_path if error.ctx is not None else name
        return _fail(f"{error.format_message()} (see {where} --help)", error.exit_code, words)
    except click.ClickException as error:
        return _fail(error.format_message(), error.exit_code, words)
    except SwarmError as error:
        return _fail(str(error), code_of(error), words)
    except SystemExit as end:
        # Click replaces `sys.stdout` if its pipe is closed, such as by `| head`, and only then.
        is_closed_pipe = sys.stdout is not stdout_at_start
        if not is_closed_pipe and end.code in (128 + signal.SIGTERM, 128 + signal.SIGHUP):
            return _fail(f"ended by {signal.Signals(end.code - 128).name}", end.code, words)
        if not is_closed_pipe:
            raise
        sys.stdout = stdout_at_start
        _discard_output(sys.stdout.fileno())
        return CLOSED_PIPE
    except UnicodeEncodeError as error:
        fault = _file_name_fault(error.object)
        if not fault:
            raise
        return _fail(fault, 2, words)
    except (MemoryError, RuntimeError) as error:
        if isinstance(error, RuntimeError) and str(error) != "can't start new thread":
            raise
        fault = "no memory or thread is left for this process; a daemon needs 2 GB of addresses"
        return _fail(
            f"{fault} (ulimit -v, LimitAS=) and 40 threads (ulimit -u, TasksMax=)", 1, words
        )
    except OSError as error:  # an error of the system, such as a full disk
        import logging

        logging.getLogger(__name__).debug("where it was raised", exc_info=True)
        return _fail(_system_fault(error), 1, words)


def _discard_output(descriptor: int) -> None:
    """Discard what is written to a file descriptor from now on, and what its buffer holds."""
    os.dup2(os.open(os.devnull, os.O_WRONLY), descriptor)


def _file_name_fault(text: str) -> str:
    """The fault of a file name that is not UTF-8, which JSON cannot contain; empty without one."""
    try:
        as_text(text)
    except ConfigError as fault:
        return str(fault)
    return ""


def _system_fault(error: OSError) -> str:
    cause = error.strerror or str(error) or type(error).__name__
    if "temporary directory" in cause:
        cause += "; make one of them writable with some room, or set TMPDIR to a folder that is"
    return cause if error.filename is None else f"{error.filename}: {cause}"


def _not_text(words: Sequence[str]) -> str:
    """The fault of the first word of a command line that is not UTF-8; empty without such a word.

    Such a word may be a file name, which JSON, manifests and messages cannot contain. A command
    line with the word `stop` or `estop` has no such fault, since a stop must not fail for a wrong
    character. These verbs send no file name, check the names of robots, and replace wrong
    characters in the reason.
    """
    # Python decodes a byte that is not UTF-8 to a lone surrogate, in this range.
    bad = next((word for word in words if any("\ud800" <= char <= "\udfff" for char in word)), None)
    if bad is None or any(map(_is_stop, words)):
        return ""
    return f"{bad!r} is not UTF-8; rename the file, or type the word again"


def _is_stop(word: str) -> bool:
    """True if a datagram carries the request of the verb `word`."""
    from swarmd.core.verbs import VERBS as requests  # not for `--help`: msgspec takes 15 ms

    return word in requests and requests[word].is_datagram


def exit_code_of(error: SwarmError) -> int:
    """2 for a wrong option or file, 6 for an unusable network, otherwise the error's code."""
    if isinstance(error, RequestError):
        return error.exit_code
    if isinstance(error, ConfigError | PluginError):
        return 2
    return 6 if isinstance(error, NetworkError) else 1


def _fail(text: str, code: int, words: Sequence[str]) -> int:
    text = " ".join(text.split())
    warn(f"error: {text}")
    # The words, since the line may have ended before its options were read.
    if _form.make_context("", list(words), resilient_parsing=True).params["output"] == "json":
        with contextlib.suppress(OSError):
            print_json("Error", {"error": text, "exit_code": code})
    return code


@click.command(context_settings={"ignore_unknown_options": True, "allow_extra_args": True})
@output_option
def _form(output: str | None) -> None:
    """Read the form of the answer from any line."""
