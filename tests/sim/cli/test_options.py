"""--pattern and --plugin-dir of the verbs that run scenarios: which of several values holds."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import click
import pytest
from click.testing import CliRunner, Result

from swarmd.core.errors import ConfigError
from swarmd.operator.cli.options import plugin_dir_option
from swarmd.operator.verbs.run.ask import Run
from swarmd.sim.cli.exp_bench import _patterns_and_folder
from swarmd.sim.cli.options import pattern_option, set_option, with_pattern
from swarmd.sim.experiments.plan import parse_sets, parse_sweeps

VARIABLE = "SWARM_PLUGIN_DIR"


@click.command()
@click.argument("scenario")
@pattern_option
@plugin_dir_option
@set_option
@click.option("--sweep", "sweeps", multiple=True)
def overrides(
    scenario: str,
    pattern: str | None,
    plugin_dir: Path | None,
    sets: tuple[str, ...],
    sweeps: tuple[str, ...],
) -> None:
    """Print the overrides as JSON."""
    swept = parse_sweeps(sweeps)
    values = with_pattern(
        scenario, parse_sets(sets), pattern=pattern, plugin_dir=plugin_dir, swept=swept
    )
    click.echo(json.dumps(values))


@click.command()
@click.option("--pattern", "patterns", multiple=True)
@plugin_dir_option
def bench_patterns(patterns: tuple[str, ...], plugin_dir: Path | None) -> None:
    """Print the patterns of `exp bench` and their folder as JSON."""
    names, folder = _patterns_and_folder(patterns, plugin_dir)
    click.echo(json.dumps([names, None if folder is None else str(folder)]))


@pytest.fixture(autouse=True)
def here(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """The working directory, with patterns in two folders and two scenarios."""
    for file in ("mine/wall.py", "mine/door.py", "other/far.py"):
        (tmp_path / file).parent.mkdir(exist_ok=True)
        (tmp_path / file).write_text("")
    groups = "groups: {a: {count: 1, pattern: drive}}\n"
    (tmp_path / "own.yaml").write_text(f"plugin_dir: other\n{groups}")
    (tmp_path / "some.yaml").write_text("groups: {a: {count: 1, pattern: drive}, b: {count: 1}}\n")
    monkeypatch.chdir(tmp_path)
    return tmp_path


def given(*words: str, variable: str = "", of: click.Command = overrides) -> Any:
    done = called(*words, variable=variable, of=of)
    assert done.exit_code == 0, done
    return json.loads(done.stdout)


def called(*words: str, variable: str = "", of: click.Command = overrides) -> Result:
    return CliRunner(env={VARIABLE: variable}).invoke(of, words)


@pytest.mark.parametrize(
    ("words", "variable", "values"),
    [
        (["--pattern", "mine/wall.py"], "", {"pattern": "mine/wall.py"}),
        (
            ["--pattern", "wall", "--plugin-dir", "mine"],
            "",
            {"pattern": "wall", "plugin_dir": "mine"},
        ),
        (["--pattern", "wall"], "mine", {"pattern": "wall", "plugin_dir": "mine"}),
        # The variable is weaker than a path, an override and the scenario's file.
        (["--pattern", "mine/wall.py"], "other", {"pattern": "mine/wall.py"}),
        (["--sweep", "pattern=drive,mine/wall.py"], "other", {}),
        (["--set", "plugin_dir=mine"], "other", {"plugin_dir": "mine"}),
        (["--set", "groups.tb3.pattern=mine/wall.py"], "other", "same"),
        ([], "", {}),
    ],
)
def test_a_path_and_an_option_are_stronger_than_the_variable(
    words: list[str], variable: str, values: Any
) -> None:
    wanted = {"groups.tb3.pattern": "mine/wall.py"} if values == "same" else values
    assert given("aggregation", *words, variable=variable) == wanted


def test_the_folder_of_the_option_but_not_of_the_variable_replaces_that_of_the_scenario() -> None:
    assert given("own.yaml", variable="mine") == {}
    assert given("own.yaml", "--plugin-dir", "mine") == {"plugin_dir": "mine"}


@pytest.mark.parametrize(
    ("words", "told"),
    [
        (["aggregation", "--pattern", "drive", "--set", "pattern=drive"], "--pattern"),
        (["aggregation", "--pattern", "drive", "--sweep", "pattern=a,b"], "--pattern"),
        (["aggregation", "--plugin-dir", "mine", "--set", "plugin_dir=other"], "--plugin-dir"),
        (["some.yaml", "--pattern", "drive"], "a drive, b nothing"),
        (["aggregation", "--pattern", "mine/absent.py"], "mine/absent.py"),
    ],
)
def test_a_line_that_means_two_things_is_refused(words: list[str], told: str) -> None:
    error = called(*words).exception
    assert isinstance(error, ConfigError)
    assert told in str(error)
    assert "\n" not in str(error)


def test_bench_takes_names_and_paths(here: Path) -> None:
    mine = str(here / "mine")
    assert given("--pattern", "drive", of=bench_patterns) == [["drive"], None]
    words = ("--pattern", "mine/wall.py", "--pattern", "door", "--pattern", "mine/wall.py")
    assert given(*words, of=bench_patterns) == [["wall", "door"], mine]
    assert given(*words, of=bench_patterns, variable="other") == [["wall", "door"], mine]
    both = ["mine/wall.py", "other/far.py"]
    apart = ("--pattern", both[0], "--pattern", both[1])
    assert given(*apart, of=bench_patterns) == [both, None]
    done = called(*apart, "--plugin-dir", "mine", of=bench_patterns)
    assert isinstance(done.exception, ConfigError)
    assert "other/far.py" in str(done.exception)


@pytest.mark.parametrize("text", ["mine/wall.py", "wall.py", "./wall"])
def test_a_run_of_robots_names_the_verb_that_sends_a_file(text: str) -> None:
    with pytest.raises(ConfigError, match=f"plugin push {text}"):
        Run(pattern=text).check()


@pytest.mark.parametrize("path", ["none", "mine/wall.py"])
def test_a_variable_that_names_no_folder_is_named_in_one_line(path: str) -> None:
    """The user has typed no --plugin-dir, of which the line would say nothing else."""
    done = called("own", variable=path)
    assert isinstance(done.exception, ConfigError)
    line = str(done.exception)
    assert VARIABLE in line
    assert path in line
    assert "\n" not in line
    typed = called("own", "--plugin-dir", path)
    assert typed.exit_code == 2
    assert VARIABLE not in typed.output
