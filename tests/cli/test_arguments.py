"""The small languages of the command line."""

from __future__ import annotations

import click
import pytest

from swarmd.cli.arguments import (
    Duration,
    NoTarget,
    Targets,
    check_name,
    read_assignments,
    read_targets,
)

KNOWN = ("r1", "tb3-01", "tb3-02", "tb3-10")


@pytest.mark.parametrize(
    ("text", "seconds"),
    [("60", 60.0), ("60s", 60.0), ("1.5m", 90.0), ("500ms", 0.5), ("2h", 7200.0), (" 3S ", 3.0)],
)
def test_reads_durations(text: str, seconds: float) -> None:
    assert Duration().convert(text, None, None) == pytest.approx(seconds)


@pytest.mark.parametrize("text", ["", "0", "0s", "-3s", "s", "3 days", "nan", "1e9h", "1e3s"])
def test_refuses_what_is_no_duration(text: str) -> None:
    with pytest.raises(click.BadParameter, match="is no duration; wanted such as 60s"):
        Duration().convert(text, None, None)


@pytest.mark.parametrize(
    ("word", "value"),
    [
        ("k=1", 1),
        ("k=-7", -7),
        ("k=0.15", 0.15),
        ("k=.5", 0.5),
        ("k=1e-3", 0.001),
        ("k=paper", "paper"),
        ("k=true", "true"),
        ("k=", ""),
        ("k=a=b", "a=b"),
        ("k=nan", "nan"),
        ("k=inf", "inf"),
        ("k=1e999", "1e999"),
        ("k=007", "007"),
        ("k=1_000", "1_000"),
        ("k=.", "."),
        ("k=-", "-"),
        ("k=9007199254740993", "9007199254740993"),
    ],
)
def test_reads_numbers_as_numbers_and_all_else_as_text(word: str, value: object) -> None:
    found = read_assignments([word])["k"]
    assert (found, type(found)) == (value, type(value))


@pytest.mark.parametrize(
    ("words", "fault"),
    [
        (["speed"], "'speed' is no key=value, such as -p speed=0.15"),
        (["=1"], "'=1' is no key=value"),
        (["k" * 65 + "=1"], "kkk...': more than 64 characters"),
        (["a=1", "a=2"], "-p a is given twice; keep one"),
        (["a=" + "x" * 257], "xxx...': more than 256 characters"),
        (["a=\udcff"], r"-p 'a=\\udcff' is not UTF-8"),
    ],
)
def test_refuses_assignments_that_are_none(words: list[str], fault: str) -> None:
    with pytest.raises(click.UsageError, match=fault):
        read_assignments(words)


def targets(*names: str, exclude: tuple[str, ...] = ()) -> Targets:
    return read_targets("run", names, not names, exclude, needed=True)


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
    ("names", "exclude", "fault"),
    [
        (("tb3-1",), (), "no robot 'tb3-1'; did you mean 'tb3-10'?"),
        (("x*",), (), "no robot 'x[*]'; there are: r1, tb3-01"),
        (("tb3-01", "tb3-9"), (), "no robot 'tb3-9'; did you mean"),
        ((), ("tb3-3",), "no robot 'tb3-3'; did you mean"),
    ],
)
def test_a_name_that_matches_no_robot_is_not_passed_over(
    names: tuple[str, ...], exclude: tuple[str, ...], fault: str
) -> None:
    with pytest.raises(NoTarget, match=fault) as caught:
        targets(*names, exclude=exclude).select(KNOWN)
    assert caught.value.exit_code == 4


def test_stopping_takes_whom_it_can_and_still_counts_the_names_nobody_knows() -> None:
    named = targets("tb3-0*", "r7", exclude=("tb3-02",))
    assert named.matching(KNOWN) == ("tb3-01",)
    assert named.unseen == ("r7",)
    assert not named.is_everyone
    assert read_targets("stop", (), False, (), needed=False).is_everyone


@pytest.mark.parametrize("name", ["**/x", "a/b", "r#1", "$x", "R1", "", "r" * 64, "é"])
def test_a_word_that_could_widen_a_key_is_no_name(name: str) -> None:
    with pytest.raises(click.UsageError, match="is no robot's name; wanted a-z"):
        read_targets("stop", (name,), False, (), needed=False)


@pytest.mark.parametrize(
    ("names", "exclude", "is_everyone"),
    [((), (), True), (("r1",), (), False), ((), ("r1",), False), (("*",), ("r1",), False)],
)
def test_only_a_halt_that_names_nobody_is_for_everyone(
    names: tuple[str, ...], exclude: tuple[str, ...], is_everyone: bool
) -> None:
    found = read_targets("estop", names, False, exclude, needed=False)
    assert found.is_everyone is is_everyone


def test_motion_needs_targets_and_says_what_to_add() -> None:
    with pytest.raises(
        click.UsageError, match=r"run needs targets; add robot names, a glob .* --a"
    ):
        read_targets("run", (), False, (), needed=True)


def test_names_and_all_exclude_each_other() -> None:
    with pytest.raises(click.UsageError, match="names or --all, not both"):
        read_targets("run", ("r1",), True, (), needed=True)


def test_an_exact_name_is_checked_against_the_known_ones() -> None:
    check_name("r1", KNOWN)
    with pytest.raises(NoTarget, match="no robot 'tb3-03'; did you mean"):
        check_name("tb3-03", KNOWN)
