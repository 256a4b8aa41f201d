"""File names whose bytes are not UTF-8: one line, and nothing is left."""

from __future__ import annotations

import json
import os
from collections.abc import Iterator
from pathlib import Path

import click
import pytest

from swarmd.core import verbs
from swarmd.core.errors import ConfigError
from swarmd.operator.cli.daemon import swarmd
from swarmd.operator.cli.swarmctl import cli, exit_code_of, run_cli
from swarmd.settings.yamlfile import text_of
from swarmd.sim.experiments.manifest import manifest_of
from swarmd.sim.experiments.simulate import plan_of
from tests.support.swarmctl import swarmctl

NOT_UTF8 = os.fsdecode(b"n\xff.yaml")
SCENARIO = "duration: 1\ngroups: {a: {platform: burger, count: 1, pattern: attraction}}\n"
STOPS = {name for name, row in verbs.VERBS.items() if row.is_datagram}


def leaves(group: click.Group, words: tuple[str, ...] = ()) -> Iterator[tuple[str, ...]]:
    with click.Context(group) as ctx:
        for name in group.list_commands(ctx):
            command = group.get_command(ctx, name)
            if isinstance(command, click.Group):
                yield from leaves(command, (*words, name))
            else:
                yield (*words, name)


def files(folder: Path) -> set[bytes]:
    return {os.fsencode(path) for path in folder.rglob("*")}


@pytest.fixture(autouse=True)
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """The working directory, whose own name is not UTF-8."""
    folder = tmp_path / os.fsdecode(b"d\xff")
    folder.mkdir()
    monkeypatch.chdir(folder)
    for name in (NOT_UTF8, "good.yaml"):
        Path(name).write_text(SCENARIO)
    Path("own.py").write_text("def warm(trace):\n    return 1.0\n")
    return folder


def test_no_verb_takes_a_file_whose_name_is_not_utf8(folder: Path) -> None:
    before, seen = files(folder), 0
    for words in leaves(cli):
        done = swarmctl(*words, *(["--all", "-l"] if words[0] in STOPS else []), NOT_UTF8)
        assert (done.code, done.out, done.err.count("\n")) == (2, "", 1), words
        assert "n\\udcff" in done.err
        assert ("no robot stops" in done.err) == (words[0] in STOPS), words
        seen += 1
    assert seen > 60
    assert run_cli(swarmd, ["--config", NOT_UTF8], "swarmd", exit_code_of) == 2
    assert files(folder) == before


@pytest.mark.parametrize(
    "words",
    [
        ("exp", "run", "good.yaml", "--seeds", "1", "--metrics", "own.py:warm"),
        ("exp", "run", "good.yaml", "--seeds", "1", "--metrics", "own.py:warm", "--out", "mine"),
        ("demo", "good.yaml", "--headless"),
    ],
)
def test_a_folder_whose_name_is_not_utf8_is_named_where_files_would_hold_it(
    folder: Path, words: tuple[str, ...]
) -> None:
    before = files(folder)
    done = swarmctl("-o", "json", *words)
    assert (done.code, json.loads(done.out)["exit_code"]) == (2, 2)
    assert "d\\udcff" in done.err.splitlines()[-1]
    assert files(folder) == before


def test_python_gets_the_same_error() -> None:
    with pytest.raises(ConfigError, match="UTF-8"):
        manifest_of(plan_of(NOT_UTF8, (0,)), traces=False, command=[])
    with pytest.raises(ConfigError, match="UTF-8"):
        text_of({"config": NOT_UTF8})
