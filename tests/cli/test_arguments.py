"""Durations and targets of the command line."""

from __future__ import annotations

import click
import pytest

from swarmd.cli.options import Duration, Failure
from swarmd.cli.targets import Targets, read_targets

KNOWN = ("r1", "tb3-01", "tb3-02", "tb3-10")


@pytest.mark.parametrize(
    ("text", "seconds"),
    [("60", 60.0), ("60s", 60.0), ("1.5m", 90.0), ("500ms", 0.5), ("2h", 7200.0), (" 3S ", 3.0)],
)
def test_reads_durations(text: str, seconds: float) -> None:
    assert Duration().convert(text, None, None) == pytest.approx(seconds)


@pytest.mark.parametrize("text", ["", "0", "0s", "-3s", "s", "3 days", "nan", "1e9h", "1e3s"])
def test_refuses_wrong_durations(text: str) -> None:
    with pytest.raises(click.BadParameter, match="is no duration"):
        Duration().convert(text, None, None)


def targets(*names: str, exclude: tuple[str, ...] = ()) -> Targets:
    return read_targets("run", names, not names, exclude, is_required=True)


@pytest.mark.parametrize(
    ("names", "exclude", "chosen"),
    [
        ((), (), KNOWN),
        (("tb3-01",), (), ("tb3-01",)),
        (("tb3-*",), (), ("tb3-01", "tb3-02", "tb3-10")),
        (("tb3-0?", "r1"), (), ("r1", "tb3-01", "tb3-02")),
        (("tb3-0[!1]",), (), ("tb3-02",)),
        ((), ("tb3-*",), ("r1",)),
        (("tb3-*",), ("*-01", "tb3-10"), ("tb3-02",)),
    ],
)
def test_selects_by_names_and_globs(
    names: tuple[str, ...], exclude: tuple[str, ...], chosen: tuple[str, ...]
) -> None:
    assert targets(*names, exclude=exclude).select(KNOWN) == chosen


@pytest.mark.parametrize(
    ("names", "exclude", "subject"),
    [
        (("tb3-1",), (), "'tb3-10'"),
        (("x*",), (), "'x[*]'"),
        (("tb3-01", "tb3-9"), (), "'tb3-9'"),
        ((), ("tb3-3",), "'tb3-3'"),
    ],
)
def test_a_name_that_matches_no_robot_is_an_error(
    names: tuple[str, ...], exclude: tuple[str, ...], subject: str
) -> None:
    with pytest.raises(Failure, match=subject) as caught:
        targets(*names, exclude=exclude).select(KNOWN)
    assert caught.value.exit_code == 4


def test_a_stop_goes_to_the_robots_that_match_and_counts_the_others() -> None:
    targets_to_stop = targets("tb3-0*", "r7", exclude=("tb3-02",))
    assert targets_to_stop.matching(KNOWN) == ("tb3-01",)
    assert targets_to_stop.full_names == ("r7",)


@pytest.mark.parametrize("name", ["**/x", "a/b", "r#1", "$x", "R1", "", "r" * 64, "é"])
def test_a_word_that_could_widen_a_key_is_no_name(name: str) -> None:
    with pytest.raises(click.UsageError, match="is no robot name"):
        read_targets("stop", (name,), False, (), is_required=False)


@pytest.mark.parametrize(
    ("names", "exclude", "is_whole_swarm"),
    [((), (), True), (("r1",), (), False), ((), ("r1",), False), (("*",), ("r1",), False)],
)
def test_only_targets_without_names_are_the_whole_swarm(
    names: tuple[str, ...], exclude: tuple[str, ...], is_whole_swarm: bool
) -> None:
    found = read_targets("estop", names, False, exclude, is_required=False)
    assert found.is_whole_swarm is is_whole_swarm
