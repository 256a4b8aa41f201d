"""`swarmctl plugin`: write a pattern, check it, and replace its code while robots run."""

from __future__ import annotations

import shlex
import sys
from collections import Counter
from importlib.resources import files
from importlib.util import find_spec
from pathlib import Path
from string import Template

import click

from swarmd.cli import completion
from swarmd.cli.options import (
    EXISTING_FILE,
    FOLDER,
    CommonOptions,
    VerbGroup,
    common_options,
    local_options,
)
from swarmd.cli.output import print_json
from swarmd.cli.plugin_push import list_pushed, push, remove
from swarmd.cli.send import send_to
from swarmd.cli.targets import takes_targets
from swarmd.client.targets import Targets
from swarmd.core.errors import ConfigError, PluginError
from swarmd.core.keys import is_id
from swarmd.core.verbs import ReloadRequest
from swarmd.plugins import PATTERN_FILE, check_module_name, class_name, installed_patterns
from swarmd.texts.values import printable

# A trial on a robot may take 10 s, and loading again 3 s more.
RELOAD_TIMEOUT = 15.0
CHECK_TIMEOUT = 30.0  # s for one point
_MARKS = {"ok": "ok  ", "fault": "FAIL", "skipped": "skip"}
_NAME_WIDTH = 43


@click.group(cls=VerbGroup)
def plugin() -> None:
    """Patterns of your own, a file or a folder each."""


@plugin.command("new")
@click.argument("name")
@click.option(
    "--dir", "folder", type=FOLDER, default=Path(), help="The folder to write to [the current one]."
)
@click.option(
    "--kind",
    type=click.Choice(["movement", "voting", "pattern"]),
    default="movement",
    help="The kind of pattern [movement].",
)
@click.option(
    "--policy",
    type=EXISTING_FILE,
    help="A learned policy, .npz or .onnx of docs/learning.md: NAME.py holds it and runs it.",
)
@click.option(
    "--folder",
    "has_folder",
    is_flag=True,
    help="Write NAME/pattern.py, its test, a scenario and a page, as packages have them.",
)
@local_options
def new(
    options: CommonOptions,
    name: str,
    folder: Path,
    kind: str,
    policy: Path | None,
    has_folder: bool,
) -> None:
    """Write a pattern, NAME.py, and its test, test_NAME.py: both pass as they are."""
    written = write_plugin(name, folder, kind, policy, has_folder=has_folder)
    python = shlex.quote(sys.executable)
    get = "" if find_spec("pytest") else f"{python} -m pip install pytest && "
    steps = [
        (f"swarmctl plugin check {written[0]}", "the contract of all patterns"),
        (f"{get}{python} -m pytest {written[1]}", "the same, and an example of a test"),
        (f"swarmctl demo --pattern {name} --plugin-dir {folder}", "simulated robots run it"),
    ]
    if has_folder:
        run = f"swarmctl exp run {written[2]} --seeds 20 --out runs/{name}"
        steps.append((run, "twenty runs of its scenario"))
    if options.is_json:
        files = [str(path) for path in written]
        print_json("Plugin", {"name": name, "files": files, "next": [line for line, _ in steps]})
        return
    click.echo(f"wrote {', '.join(map(str, written[:-1]))} and {written[-1]}; next:\n")
    width = max(len(line) for line, _ in steps)
    for line, text in steps:
        click.echo(f"  {line.ljust(width)}  # {text}")
    what = f"the folder {name}" if has_folder else f"{name}.py"
    click.echo(f"\nOn a robot, put {what} into the folder that its plugin_dir names.")


@plugin.command("check")
@click.argument("file", type=EXISTING_FILE)
@local_options
def check(options: CommonOptions, file: Path) -> None:
    """Check the pattern in FILE against the contract: a line for each point, each fault once.

    The file is imported in a process of its own. `--timeout` is for each point [30s].
    """
    from swarmd.cli.plugin_check import check_file

    if file.suffix != ".py":
        raise click.UsageError(
            f"{file} is no .py; a mission is checked by `swarmctl mission check`"
        )
    points = []
    for point in check_file(file, options.timeout or CHECK_TIMEOUT):
        points.append(point)
        if not options.is_json and point.result != "repeated":
            line = f"{_MARKS[point.result]}  {point.name.ljust(_NAME_WIDTH)}  {point.text}"
            click.echo(printable(line.rstrip()))
    results = Counter(point.result for point in points)
    bad = len(points) - results["ok"]
    if options.is_json:
        rows = [
            {"point": point.name, "result": point.result, "text": point.text} for point in points
        ]
        print_json("Check", {"file": str(file), "is_well": bad == 0, "points": rows})
    else:
        how = f"{results['fault']} faults" if results["fault"] != 1 else "1 fault"
        if results["repeated"]:
            count = results["repeated"]
            how += f", repeated at {count} other point{'s' if count > 1 else ''}"
        click.echo(f"{len(points)} checked, {how if bad else 'all ok'}")
    click.get_current_context().exit(1 if bad else 0)


@plugin.command("reload")
@click.argument("name", shell_complete=completion.patterns)
@takes_targets(is_required=True)
@click.option("--run", "is_run", is_flag=True, help="Run again where it ran, with its parameters.")
@common_options
def reload(options: CommonOptions, name: str, targets: Targets, is_run: bool) -> None:
    """Replace the code of pattern NAME on TARGETS: names, globs such as 'tb3-*', or --all.

    Each robot first tries the new code in a process of its own. If that fails, the robot refuses
    with the reason and keeps running the old code. Else a robot that runs NAME stops, and its
    pattern host is replaced. Other patterns keep running.
    """
    if not is_id(name):
        raise click.UsageError(f"{name!r} is no pattern name; see `swarmctl patterns`")
    fields = {"pattern": name, "is_rerun": is_run}
    send_to(options, ReloadRequest, targets, least=RELOAD_TIMEOUT, **fields)


plugin.add_command(push)
plugin.add_command(list_pushed)
plugin.add_command(remove)


def write_plugin(
    name: str, folder: Path, kind: str, policy: Path | None = None, *, has_folder: bool = False
) -> tuple[Path, ...]:
    """Write pattern and test and return their paths; with `has_folder` also scenario and page.

    The texts are those of `templates/`. With `policy` the pattern is that of the network in it.
    UsageError for an unusable name and ConfigError without a network: no file is written then.
    """
    if policy is not None and kind != "movement":
        raise click.UsageError(f"--kind {kind} means nothing beside --policy; leave it out")
    network = "" if policy is None else _network_text(policy)
    kind = kind if policy is None else "policy"
    _check_name(name)
    own = folder / name if has_folder else folder
    paths = {
        kind: own / (PATTERN_FILE if has_folder else f"{name}.py"),
        f"test_{kind}": own / f"test_{name}.py",
    }
    if has_folder:
        paths |= {"scenario": own / "scenario.yaml", "page": own / "page.md"}
    for path in paths.values():
        if path.exists():
            raise click.UsageError(f"{path} is there already; move it away or take another name")
    _check_free(name)
    templates = files("swarmd.cli") / "templates"
    texts = {path: (templates / f"{head}.txt").read_text() for head, path in paths.items()}
    title = class_name(name)
    if title in "".join(texts.values()):  # such as Twist, which it imports
        title += "Pattern"
    own.mkdir(parents=True, exist_ok=True)
    module = paths[kind].stem
    for path, text in texts.items():
        with path.open("x", encoding="utf-8") as file:
            fields = {"name": name, "module": module, "kind": title, "network": network}
            file.write(Template(text).substitute(fields))
    return tuple(texts)


def _network_text(policy: Path) -> str:
    """The network in a file as text; ConfigError names the file."""
    from swarmd.kit.policy_network import network_from_bytes, to_text  # it imports numpy
    from swarmd.kit.policy_onnx import network_from_onnx

    try:
        data = policy.read_bytes()
        is_onnx = policy.suffix == ".onnx"
        return to_text(network_from_onnx(data) if is_onnx else network_from_bytes(data))
    except (ConfigError, OSError) as error:
        raise ConfigError(f"{policy}: {error}") from error


def _check_name(name: str) -> None:
    try:
        check_module_name(name)
    except PluginError as error:
        raise click.UsageError(str(error)) from error


def _check_free(name: str) -> None:
    """UsageError if a module or an installed pattern has the name."""
    origin = installed_patterns().get(name)
    if origin is not None:
        raise click.UsageError(f"{origin.source} has a pattern {name!r}; take another name")
    if name in sys.stdlib_module_names or find_spec(name) is not None:
        raise click.UsageError(f"{name!r} is the name of a Python module; take another name")
