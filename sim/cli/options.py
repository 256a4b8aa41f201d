"""Options of several verbs: robots, arena, layout, metrics; and a check for missing libraries."""

from __future__ import annotations

import functools
import logging
import os
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from functools import partial
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from swarmd.core.errors import ConfigError, PluginError, R
from swarmd.operator.cli import completion
from swarmd.operator.cli.options import CommonOptions, plugin_dir_option
from swarmd.operator.cli.output import warn
from swarmd.operator.cli.targets import Function
from swarmd.sim.live.fleet_spec import MAX_ROBOTS, plain_fleet, scenario_fleet

if TYPE_CHECKING:
    from click.shell_completion import CompletionItem

    from swarmd.sim.experiments.simulate import Runner
    from swarmd.sim.live.fleet import FleetSpec
    from swarmd.sim.metrics.metric import Metric


_OPTIONS = (
    click.option(
        "-n", "count", type=click.IntRange(1, MAX_ROBOTS), default=7, help="Number of robots [7]."
    ),
    click.option(
        "--platform",
        default="waffle_pi",
        show_default=True,
        help="A platform, or a .yaml file.",
        shell_complete=completion.platforms,
    ),
    click.option(
        "--arena",
        metavar="LxW[,THING]",
        help="Size in m, such as 6x6, then obstacles: ,box:x:y:l:w:deg or ,pole:x:y:r or"
        " ,segment:x1:y1:x2:y2 (an inner wall); robots can push a ,box:x:y:l:w:deg:kg.",
    ),
    click.option(
        "--layout",
        metavar="NAME[:SIZE]",
        help="Start poses: row, paper, grid, ring or random, or list:X:Y:DEG,X:Y:DEG,.. with a pose"
        " for each robot.",
    ),
    click.option(
        "--seed",
        type=click.IntRange(min=0),
        default=0,
        show_default=True,
        help="Seed of random layouts, and of noise and radio.",
    ),
    click.option(
        "--realism",
        type=click.Choice(["realistic", "ideal"]),
        default="realistic",
        show_default=True,
        help="With noise and delays of sensors and bases, or without.",
    ),
    click.option(
        "--lidar-visibility",
        type=click.Choice(["body", "real"]),
        default="body",
        show_default=True,
        help="Lidars detect whole robots, or only the parts at the height of the lidar.",
    ),
    click.option(
        "--radio-range",
        type=click.FloatRange(min=0.0, min_open=True),
        metavar="M",
        help="Robots farther apart than this do not receive each other [no limit].",
    ),
    click.option(
        "--emulate",
        "emulator",
        metavar="NAME",
        help="Simulate the wire protocol of this driver, such as ros2dds; daemons use that driver.",
    ),
    plugin_dir_option,
)


folder_argument = click.argument("folder", metavar="DIR", type=click.Path(path_type=Path))
trust_option = click.option(
    "--trust",
    "is_trusted",
    is_flag=True,
    help="Run the Python files that the results name, with your rights, although they are new, have"
    " changed or were never run by you.",
)
set_option = click.option(
    "--set",
    "sets",
    multiple=True,
    metavar="KEY=VALUE",
    help="Override a value of SCENARIO, such as duration=30; may be repeated.",
)


def out_option(
    text: str, *names: str, is_file: bool = False, **others: Any
) -> Callable[[Function], Function]:
    """The option --out, a folder or a file; `names` are further names of the option."""
    kind: click.Path[Path] = click.Path(file_okay=is_file, dir_okay=not is_file, path_type=Path)
    metavar = "FILE" if is_file else "DIR"
    return click.option(*names, "--out", type=kind, metavar=metavar, help=text, **others)


def scenarios(ctx: click.Context, param: click.Parameter, incomplete: str) -> list[CompletionItem]:
    """What Tab offers for a scenario: those that are shipped, else files."""
    from swarmd.sim.scenarios.scenariofile import scenario_names

    return completion.names_or_files(scenario_names(), incomplete)


def output_option(function: Callable[..., R]) -> Callable[..., R]:
    """Give a verb the parameter `is_json`: -o of the verb, else that of swarmctl."""

    @functools.wraps(function)
    def wrapper(*args: Any, output: str | None, **kwargs: Any) -> R:
        common = click.get_current_context().find_object(CommonOptions) or CommonOptions()
        return function(*args, is_json=(output or common.output) == "json", **kwargs)

    choice = click.Choice(["table", "json"])
    return click.option("-o", "--output", type=choice, help="Form of the answer [table].")(wrapper)


def fleet_options(function: Function) -> Function:
    """Give a verb the argument SCENARIO and the options of a fleet."""
    for option in reversed(_OPTIONS):
        function = option(function)
    named = click.argument("scenario", required=False, shell_complete=scenarios)
    return named(set_option(function))


def fleet_for(
    swarm: str,
    folder: Path,
    *,
    scenario: str | None,
    sets: tuple[str, ...],
    plugin_dir: Path | None,
    pattern: str | None = None,
    **others: Any,
) -> FleetSpec:
    """The fleet by the values of `fleet_options`: of `scenario`, or of one platform without it.

    `pattern`: what the robots of a scenario run in place of its pattern; None: its own.
    """
    if scenario is not None:
        from swarmd.sim.experiments.plan import parse_sets

        _check_options()
        values = with_pattern(scenario, parse_sets(sets), pattern=pattern, plugin_dir=plugin_dir)
        given = {"seed": others["seed"], "emulator": others["emulator"]}
        return scenario_fleet(swarm, folder, scenario, values, **given, tell=warn)
    if sets:
        raise ConfigError(f"--set {sets[0]}: there is no SCENARIO whose values it could override")
    return plain_fleet(swarm, folder, tell=warn, plugin_dir=plugin_dir, **others)


pattern_option = click.option(
    "--pattern",
    metavar="NAME|FILE",
    help="What all robots run in place of the pattern of SCENARIO: a name, or your file or folder.",
    shell_complete=completion.patterns_or_files,
)


def with_pattern(
    scenario: str,
    sets: Mapping[str, Any],
    *,
    pattern: str | None,
    plugin_dir: Path | None,
    swept: Mapping[str, Sequence[Any]] | None = None,
) -> dict[str, Any]:
    """The overrides `sets` of a scenario with those of the options --pattern and --plugin-dir.

    A folder of the variable $SWARM_PLUGIN_DIR is weaker than that of the scenario, and than that of
    a pattern which is given by its path. `swept`: the values of `--sweep`. ConfigError if a value
    is given twice, or if it is not clear which robots --pattern means.
    """
    from swarmd.plugins import is_pattern_path
    from swarmd.sim.scenarios.scenariofile import read_scenario

    values = dict(sets)
    given = {"--pattern": pattern is not None, "--plugin-dir": _is_given("plugin_dir")}
    for option, is_there in given.items():
        key = option.removeprefix("--").replace("-", "_")
        if is_there and (key in values or key in (swept or {})):
            raise ConfigError(f"{option} and {key}=.. of --set or --sweep: keep one of them")
    if pattern is not None:
        values["pattern"] = pattern
        file = read_scenario(scenario, values)
        has_choice = file.patterns or read_scenario(scenario, sets).pattern is not None
        groups = {name: group.pattern for name, group in file.groups.items()}
        if not has_choice and None in groups.values() and any(groups.values()):
            runs = ", ".join(f"{name} {run or 'nothing'}" for name, run in groups.items())
            raise ConfigError(
                f"--pattern {pattern}: not all groups of {scenario} run a pattern from the start"
                f" ({runs}); choose by --set groups.GROUP.pattern={pattern}"
            )
    if plugin_dir is not None and not _is_given("plugin_dir"):  # of the variable
        has_path = any(
            isinstance(value, str) and is_pattern_path(value)
            for key, of_key in (swept or {}).items()
            for value in of_key
            if key.endswith("pattern")
        )
        if has_path or read_scenario(scenario, values).plugin_dir is not None:
            return values
    if plugin_dir is not None:
        values["plugin_dir"] = str(plugin_dir)
    return values


def _is_given(option: str) -> bool:
    """Whether the command line has the option, which may also have its value from a variable."""
    source = click.get_current_context().get_parameter_source(option)
    return source is click.core.ParameterSource.COMMANDLINE


_OF_PLAIN_RUNS = {
    "count": "groups.GROUP.count",
    "platform": "groups.GROUP.platform",
    "arena": "arena.size",
    "layout": "start.layout",
    "realism": "realism",
    "lidar_visibility": "lidar_visibility",
    "radio_range": "radio.range",
    "params": "groups.GROUP.parameters.KEY",
    "seconds": "duration",
}
"""Options that a scenario replaces, each with its key."""


def _check_options() -> None:
    """ConfigError for options that a scenario replaces."""
    for option in click.get_current_context().command.params:
        key = _OF_PLAIN_RUNS.get(option.name or "")
        if key is not None and _is_given(option.name or ""):
            text = f"{option.opts[0]} does not go with a scenario"
            raise ConfigError(f"{text}; change the value in the file, or with --set {key}=VALUE")


def need(*modules: str, extra: str = "sim,plot") -> None:
    """PluginError for the first missing module, with the command that installs the module."""
    for module in modules:
        if find_spec(module) is None:
            raise PluginError(
                f"this verb needs {module}, which is not installed;"
                f" run: pip install 'swarmd[{extra}]'"
            )
    if "matplotlib" in modules:  # where the home cannot be written, it tells of its own cache
        logging.getLogger("matplotlib").setLevel(logging.ERROR)
        from swarmd.sim.plots.theme import ignore_settings_of_user

        ignore_settings_of_user()
    if "mujoco" in modules:  # no picture is made with OpenGL, and a wrong value stops the import
        os.environ.pop("MUJOCO_GL", None)


def chosen_metrics(
    text: str | None, about: Callable[[str], Metric] | None = None
) -> tuple[Metric, ...] | None:
    """The metrics named by `--metrics A,B`; None if the option is not given (`text` is None).

    `about`: a function that finds a metric by name, such as `Results.asked`, which also knows the
    custom metrics of the experiment; None: `metric_of`. ConfigError with the nearest name for an
    unknown metric.
    """
    if text is None:
        return None
    from swarmd.sim.metrics.catalog import metric_of

    names = tuple(dict.fromkeys(name.strip() for name in text.split(",") if name.strip()))
    if not names:
        raise ConfigError("--metrics is empty; see `swarmctl exp metrics`")
    return tuple(map(about or metric_of, names))


def warn_of_few(counts: Iterable[int]) -> None:
    """Warn if a variant, or a row of a table, has fewer runs than a 95 % interval needs.

    `counts`: the number of runs of each; 0 is left out.
    """
    from swarmd.sim.experiments.statistics import FEW

    fewest = min((n for n in counts if n), default=FEW)
    if fewest == 1:
        warn("only 1 run: run more seeds, such as 20, before you draw conclusions")
    elif fewest < FEW:
        warn(f"only {fewest} runs: intervals of so few are too narrow; 20 seeds are a good number")


def workers(jobs: int | None, timeout: float | None, cores: int = 1) -> Runner:
    """A function that does runs in worker processes, each run on `cores` cores.

    `jobs`: runs at a time; None: as many as there are cores for. `timeout`: s without progress
    after which a run fails; None: STEP_TIMEOUT.
    """
    from swarmd.sim.experiments.cores import usable_cores
    from swarmd.sim.experiments.pool import STEP_TIMEOUT, run_jobs

    processes = jobs or max(1, usable_cores() // cores)
    seconds = STEP_TIMEOUT if timeout is None else timeout
    return partial(run_jobs, processes=processes, timeout=seconds, cores=cores)


fresh_option = click.option(
    "--fresh",
    "is_fresh",
    is_flag=True,
    help="Do all runs, also those whose results the store of runs has, and keep none there; also"
    " off by SWARMD_RUN_STORE=off.",
)


def engine_options(command: Function) -> Function:
    """Options that name the machines of the runs, as keywords `on` and `scheduler_file`."""
    for option in (
        click.option(
            "--scheduler-file",
            type=click.Path(path_type=Path, dir_okay=False),
            metavar="FILE",
            help="As --on, with the file that `dask scheduler --scheduler-file` has written.",
        ),
        click.option(
            "--on",
            metavar="ADDRESS",
            help="Do the runs on the workers of a Dask cluster: tls://HOST:8786, or tcp://.",
        ),
    ):
        command = option(command)
    return command


@contextmanager
def engine(
    jobs: int | None,
    timeout: float | None,
    cores: int | None = None,
    *,
    on: str | None = None,
    scheduler_file: Path | None = None,
) -> Iterator[Runner]:
    """What does the runs of a verb: a Dask cluster if one is named, else worker processes.

    `jobs`, `timeout` and `cores` as for `workers`. ConfigError if a cluster is named twice or with
    `jobs`, or does not answer.
    """
    if on is None and scheduler_file is None:
        yield workers(jobs, timeout, cores or 1)
        return
    if on is not None and scheduler_file is not None:
        raise ConfigError("--on and --scheduler-file both name a cluster; give one of them")
    if jobs is not None:
        raise ConfigError("--jobs beside a cluster: each thread of its workers does one run")
    need("distributed", extra="sim,plot,cluster")
    from swarmd.sim.experiments.executor import address_in, dask_cluster, on_executor
    from swarmd.sim.experiments.pool import STEP_TIMEOUT

    address = on if scheduler_file is None else address_in(scheduler_file)
    with dask_cluster(address or "", warn=warn) as executor:
        yield on_executor(executor, STEP_TIMEOUT if timeout is None else timeout, cores or 1)


def new_folder(base: Path, names: Iterable[str]) -> Path:
    """Make a folder in `base` with the first of `names` that is free; returns its path.

    When the verb ends, the new folder is removed if it is still empty, and then also `base` if this
    function made `base`. ConfigError if no folder can be made.
    """
    base_existed = base.exists()
    for name in names:
        try:
            (base / name).mkdir(parents=True)
            if (ctx := click.get_current_context(silent=True)) is not None:
                new_folders = (base / name,) if base_existed else (base / name, base)
                ctx.call_on_close(partial(_remove_empty, new_folders))
            return base / name
        except OSError as error:
            if not (base / name).exists():  # else the name is taken: try the next name
                text = f"{base / name}/ cannot be made ({error.strerror})"
                raise ConfigError(f"{text}; work in another folder, or name one") from error
    raise ConfigError(f"{base}/ has no free name left; remove some folders of it")


def _remove_empty(folders: Iterable[Path]) -> None:
    """Remove empty folders in this order, up to the first folder that is not empty."""
    with suppress(OSError):  # a folder is not empty
        for folder in folders:
            folder.rmdir()
