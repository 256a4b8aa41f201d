"""Contexts: their file, the one in use, and what counts more than a context."""

from __future__ import annotations

from pathlib import Path

import pytest

from swarmd.core.errors import ConfigError
from swarmd.operator.cli.options import CommonOptions
from swarmd.settings.contexts import (
    Context,
    add_context,
    context_in_use,
    contexts_path,
    load_contexts,
    save_contexts,
)

MEADOW = Context(swarm="meadow", profile="field", interface="wlan0", seeds=("tcp/10.0.0.5:7440",))


@pytest.fixture
def home(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A home without contexts, and an environment that names no swarm."""
    monkeypatch.setenv("HOME", str(tmp_path))
    for name in ("XDG_CONFIG_HOME", "SWARM", "SWARM_CONFIG", "SWARM_CONTEXT"):
        monkeypatch.delenv(name, raising=False)
    return tmp_path


def test_without_contexts_options_stay(home: Path) -> None:
    assert context_in_use() is None
    assert CommonOptions(swarm="own").in_context() == CommonOptions(swarm="own")


def test_a_context_is_kept_and_used(home: Path) -> None:
    add_context("meadow", MEADOW)
    assert context_in_use() is None
    path = add_context("meadow", MEADOW, use=True)
    assert path == home / ".config/swarmd/contexts.yaml"
    assert context_in_use() == ("meadow", MEADOW)
    save_contexts(path, load_contexts(path).without("meadow"))
    assert context_in_use() is None


def test_an_option_then_the_environment_count_more_than_the_context(
    home: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    add_context("meadow", MEADOW, use=True)
    found = CommonOptions(interface="wlan1").in_context()
    assert (found.swarm, found.profile, found.interface) == ("meadow", "field", "wlan1")
    assert found.seeds == MEADOW.seeds
    add_context("wlan", Context(profile="field", interface="wlan0"), use=True)
    monkeypatch.setenv("SWARM", "lab")
    found = CommonOptions().in_context()
    assert (found.swarm, found.interface) == ("lab", "wlan0")
    assert CommonOptions(swarm="own").in_context().swarm == "own"


def test_a_context_of_one_swarm_is_not_used_for_another(
    home: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    add_context("meadow", MEADOW, use=True)
    assert CommonOptions(swarm="meadow").in_context().interface == "wlan0"
    assert CommonOptions(swarm="lab").in_context() == CommonOptions(swarm="lab")
    monkeypatch.setenv("SWARM", "lab")
    assert CommonOptions().in_context() == CommonOptions()


def test_a_swarm_file_takes_the_place_of_the_context(home: Path) -> None:
    add_context("meadow", MEADOW, use=True)
    given = CommonOptions(config=Path("swarm.yaml"))
    assert given.in_context() == given


def test_the_environment_names_another_context(home: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    add_context("meadow", MEADOW, use=True)
    add_context("class", Context(config="/class/swarm.yaml"))
    monkeypatch.setenv("SWARM_CONTEXT", "class")
    found = CommonOptions().in_context()
    assert (found.config, found.profile) == (Path("/class/swarm.yaml"), None)
    monkeypatch.setenv("SWARM_CONTEXT", "clas")
    with pytest.raises(ConfigError, match="'class'"):
        CommonOptions().in_context()


@pytest.mark.parametrize(
    ("text", "subject"),
    [
        ("use: meadw\ncontexts: {meadow: {swarm: meadow}}", "'meadow'"),
        ("contexts: {meadow: {swrm: meadow}}", "contexts.meadow"),
        ("contexts: {meadow: {profile: mesh}}", "contexts.meadow.profile"),
        ("contexts: {meadow: {swarm: Meadow}}", "'Meadow'"),
        ("contexts: {meadow: {seeds: [10.0.0.5]}}", "'10.0.0.5'"),
        ("contexts: {meadow: {config: swarm.yaml}}", "absolute"),
    ],
)
def test_a_fault_of_the_file_is_one_line(home: Path, text: str, subject: str) -> None:
    path = contexts_path()
    assert path is not None
    path.parent.mkdir(parents=True)
    path.write_text(text)
    with pytest.raises(ConfigError, match=subject) as found:
        load_contexts(path)
    assert "\n" not in str(found.value)


@pytest.mark.parametrize(
    ("name", "context"),
    [("Meadow", MEADOW), ("m", Context(swarm="-")), ("m", Context(identity="own"))],
)
def test_a_wrong_context_leaves_nothing_behind(home: Path, name: str, context: Context) -> None:
    with pytest.raises(ConfigError):
        add_context(name, context)
    assert not list(home.iterdir())


def test_without_a_home_there_is_no_context(monkeypatch: pytest.MonkeyPatch) -> None:
    assert contexts_path({}) is None
    assert context_in_use({}) is None
    with pytest.raises(ConfigError, match="HOME"):
        add_context("meadow", MEADOW, environ={})
