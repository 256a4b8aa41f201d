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

from swarmd.core.errors import ConfigError, PluginError
from swarmd.core.files import read_regular
from swarmd.core.keys import is_id
from swarmd.core.verbs import ReloadRequest
from swarmd.operator.cli import completion
from swarmd.operator.cli.options import (
    EXISTING,
    EXISTING_FILE,
    FOLDER,
    CommonOptions,
    VerbGroup,
    common_options,
    local_options,
)
from swarmd.operator.cli.output import print_json
from swarmd.operator.cli.send import send_to
from swarmd.operator.cli.targets import takes_targets
from swarmd.operator.session.targets import Targets
from swarmd.operator.texts.values import counted, printable
from swarmd.operator.verbs.push.command import list_pushed, push, remove
from swarmd.plugins import (
    PATTERN_FILE,
    check_module_name,
    class_name,
    installed_patterns,
    pattern_file,
)

RELOAD_TIMEOUT = 15.0  # s: a trial on a robot may take 10 s, and loading again 3 s more
CHECK_TIMEOUT = 30.0  # s for one point
_MARKS = {"ok": "ok  ", "fault": "FAIL", "skipped": "skip"}
_NAME_WIDTH = 43  # characters of the name of a point of the contract


@click.group(cls=VerbGroup)
def plugin() -> None:
    """Patterns of your own, a file or a folder each."""


@plugin.command("new", epilog="Example: swarmctl plugin new swirl --dir mine")
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
    help="Write the package NAME: pattern.py, its test, a scenario and a page.",
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
    paths = write_plugin(name, folder, kind, policy, has_folder=has_folder)
    plugin_file, test_file, *scenario_and_page = paths
    # The next commands, each with a remark. The path of a folder has a separator, unlike a name.
    checked = shlex.quote(str(plugin_file.parent if has_folder else plugin_file))
    path = f"{checked if '/' in checked else f'./{checked}'}" if has_folder else checked
    python = shlex.quote(sys.executable)
    install_pytest = "" if find_spec("pytest") else f"{python} -m pip install pytest && "
    test_command = f"{install_pytest}{python} -m pytest {test_file}"
    next_steps = [
        (f"swarmctl plugin check {checked}", "the contract of all patterns"),
        (test_command, "the same, and an example of a test"),
        (f"swarmctl demo --pattern {path}", "simulated robots run it"),
        (f"swarmctl exp run aggregation --pattern {path} --seeds 20", "twenty runs, measured"),
    ]
    if has_folder:
        scenario = scenario_and_page[0]
        run = f"swarmctl exp run {scenario} --seeds 20 --out runs/{name}"
        next_steps.append((run, "twenty runs of its scenario"))
    if options.is_json:
        commands = [command for command, _ in next_steps]
        content = {"name": name, "files": [str(path) for path in paths], "next": commands}
        print_json("Plugin", content)
        return
    *first_paths, last_path = map(str, paths)
    click.echo(f"wrote {', '.join(first_paths)} and {last_path}; next:\n")
    width = max(len(command) for command, _ in next_steps)
    for command, remark in next_steps:
        click.echo(f"  {command.ljust(width)}  # {remark}")
    plugin = f"the folder {name}" if has_folder else f"{name}.py"
    click.echo(f"\nOn a robot, put {plugin} into the folder that its plugin_dir names.")


@plugin.command("check", epilog="Example: swarmctl plugin check mine/swirl.py")
@click.argument("file", type=EXISTING)
@local_options
def check(options: CommonOptions, file: Path) -> None:
    """Check the pattern in FILE, a .py or its folder: a line for each point, each fault once.

    The file is imported in a process of its own. `--timeout` is for each point [30s].
    """
    from swarmd.operator.cli.plugin_check import check_file

    file = pattern_file(file)
    if file.suffix != ".py":
        raise click.UsageError(
            f"{file} is no .py; a mission is checked by `swarmctl mission check`"
        )
    # 1. Print each point (rule of the contract) as soon as it is checked. A point is `repeated` if
    #    an earlier point has already shown its fault.
    points = []
    for point in check_file(file, options.timeout or CHECK_TIMEOUT):
        points.append(point)
        if not options.is_json and point.result != "repeated":
            line = f"{_MARKS[point.result]}  {point.name.ljust(_NAME_WIDTH)}  {point.text}"
            click.echo(printable(line.rstrip()))
    # 2. Summarise.
    counts = Counter(point.result for point in points)
    is_well = counts["ok"] == len(points)
    if options.is_json:
        rows = [
            {"point": point.name, "result": point.result, "text": point.text} for point in points
        ]
        print_json("Check", {"file": str(file), "is_well": is_well, "points": rows})
    else:
        summary = counted(counts["fault"], "fault")
        if repeated := counts["repeated"]:
            summary += f", repeated at {counted(repeated, 'other point')}"
        click.echo(f"{len(points)} checked, {'all ok' if is_well else summary}")
    click.get_current_context().exit(0 if is_well else 1)


@plugin.command("reload", epilog="Example: swarmctl plugin reload shy --all --run")
@click.argument("name", shell_complete=completion.patterns)
@takes_targets(is_required=True)
@click.option("--run", "is_run", is_flag=True, help="Run again where it ran, with its parameters.")
@common_options
def reload(options: CommonOptions, name: str, targets: Targets, is_run: bool) -> None:
    """Replace the code of pattern NAME on TARGETS: names, globs such as 'tb3-*', or --all.

    Each robot first tries the new code in a process of its own. If the trial fails, the robot
    refuses with the reason and keeps the old code. Otherwise a robot that runs NAME stops, and its
    pattern host is replaced. A robot that runs another pattern keeps running.
    """
    if not is_id(name):
        raise click.UsageError(f"{name!r} is no pattern name; see `swarmctl patterns`")
    fields = {"pattern": name, "is_rerun": is_run}
    send_to(options, ReloadRequest, targets, least_timeout=RELOAD_TIMEOUT, **fields)


plugin.add_command(push)
plugin.add_command(list_pushed)
plugin.add_command(remove)


def write_plugin(
    name: str, folder: Path, kind: str, policy: Path | None = None, *, has_folder: bool = False
) -> tuple[Path, ...]:
    """Write a pattern and its test from the templates in `templates/`.

    Returns the paths of the pattern, its test, and with `has_folder` those of the scenario, the
    page and `__init__.py`.

    `kind`: the template of the pattern. `policy`: a file with a neural network; the pattern then
    runs that network. `has_folder`: also write a scenario and a page, and all files into a new
    folder `name`. UsageError for an unusable name or an existing file, ConfigError for a `policy`
    without a network; nothing is written then.
    """
    if policy is not None and kind != "movement":
        raise click.UsageError(f"--kind {kind} means nothing beside --policy; leave it out")
    network = "" if policy is None else _network_text(policy)
    template = kind if policy is None else "policy"
    _check_name(name)
    plugin_folder = folder / name if has_folder else folder
    plugin_file = plugin_folder / (PATTERN_FILE if has_folder else f"{name}.py")
    test_file = plugin_folder / f"test_{name}.py"
    path_by_template = {template: plugin_file, f"test_{template}": test_file}
    if has_folder:
        path_by_template["scenario"] = plugin_folder / "scenario.yaml"
        path_by_template["page"] = plugin_folder / "page.md"
        path_by_template["package"] = plugin_folder / "__init__.py"
    for path in path_by_template.values():
        if path.exists():
            raise click.UsageError(f"{path} is there already; move it away or take another name")
    _check_free(name)
    templates = files("swarmd.operator.cli") / "templates"
    texts = {
        path: (templates / f"{stem}.txt").read_text() for stem, path in path_by_template.items()
    }
    class_title = class_name(name)
    is_used = class_title in "".join(texts.values())  # by the templates themselves, such as Twist
    if is_used:
        class_title += "Pattern"
    fields = {  # values for the fields of the templates, such as `$class_name`
        "name": name,
        "module": f"{name}.{plugin_file.stem}" if has_folder else name,
        "class_name": class_title,
        "network": network,
    }
    plugin_folder.mkdir(parents=True, exist_ok=True)
    for path, text in texts.items():
        with path.open("x", encoding="utf-8") as file:
            file.write(Template(text).substitute(fields))
    return tuple(path_by_template.values())


def _network_text(policy: Path) -> str:
    """The network in a file as text; ConfigError names the file."""
    from swarmd.kit.policy_network import network_from_bytes, to_text  # it imports numpy
    from swarmd.kit.policy_onnx import network_from_onnx

    try:
        data = read_regular(policy)
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
