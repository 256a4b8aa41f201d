"""Options of `run` and `label` that are refused before a robot is asked, and targets of goals."""

from __future__ import annotations

import click
import pytest

from swarmd.operator.cli.swarmctl import cli, exit_code_of, run_cli
from swarmd.operator.session.targets import Targets
from swarmd.operator.verbs.label.command import label
from swarmd.operator.verbs.run.ask import goal_targets


@pytest.mark.parametrize(
    ("words", "subject"),
    [
        (["--at", "3s"], "+3s"),
        (["--at", "+90s"], "60 s"),
        (["--on-join", "run"], "--valid"),
        (["--valid", "5m"], "--on-join run"),
        (["--lease", "500ms"], "--lease"),
        (["--canary-time", "5s"], "--canary"),
        (["--canary", "0"], "--canary 0"),
        (["--canary", "Big"], "--canary Big"),
        (["--at", "+3s", "--canary", "1"], "together"),
        (["--lease", "5s", "--at", "+3s"], "together"),
        (["--until", "nerer:1"], "nearer"),
        (["-l", "Red"], "'Red'"),
    ],
)
def test_run_refuses_options_that_cannot_be(
    capsys: pytest.CaptureFixture[str], words: list[str], subject: str
) -> None:
    targets = [] if "-l" in words else ["--all"]
    assert run_cli(cli, ["run", "drive", *targets, *words], "swarmctl", exit_code_of) == 2
    error = capsys.readouterr().err
    assert subject in error
    assert error.count("\n") == 1


@pytest.mark.parametrize(
    ("targets", "of_goal"),
    [
        (Targets(), ()),
        (Targets(("tb3-*", "r1")), ("tb3-*", "r1")),
        (Targets(("r1",), labels=("red", "fast")), ("r1", "label:red", "label:fast")),
        (Targets(("r*",), exclude=("r3",)), ("r1", "r2")),
    ],
)
def test_the_targets_of_a_goal_are_those_of_the_line(
    targets: Targets, of_goal: tuple[str, ...]
) -> None:
    assert goal_targets(targets, ("r2", "r1")) == of_goal


@pytest.mark.parametrize(
    ("words", "added", "removed"),
    [
        (["r1", "+red", "-blue"], ("red",), ("blue",)),
        (["+red", "-l", "blue", "-o", "json"], ("red",), ()),
        (["--add", "red", "--all", "-slow", "-fast"], ("red",), ("slow", "fast")),
    ],
)
def test_signs_of_labels_are_options(
    words: list[str], added: tuple[str, ...], removed: tuple[str, ...]
) -> None:
    context = click.Context(label)
    label.parse_args(context, words)
    assert (context.params["added"], context.params["removed"]) == (added, removed)


@pytest.mark.parametrize(
    "words", [["r1"], ["r1", "+Red"], ["r1", "+red", "-red"], ["r1", "+red", "--reset"], ["+red"]]
)
def test_label_refuses_what_is_no_change(
    capsys: pytest.CaptureFixture[str], words: list[str]
) -> None:
    assert run_cli(cli, ["label", *words], "swarmctl", exit_code_of) == 2
    assert capsys.readouterr().err.count("\n") == 1
