"""Names in ranges, and how they are chosen."""

from __future__ import annotations

import pytest

from swarmd.core.errors import ConfigError, unknown
from swarmd.core.names import check_distinct, expand_names, select_names


@pytest.mark.parametrize(
    ("text", "names"),
    [
        ("tb3-[01-03]", ("tb3-01", "tb3-02", "tb3-03")),
        ("r[8-11]", ("r8", "r9", "r10", "r11")),
        ("r[098-101]", ("r098", "r099", "r100", "r101")),
        ("a,b, c", ("a", "b", "c")),
        ("r[1,3,5-6],x", ("r1", "r3", "r5", "r6", "x")),
        ("[1-2]-[1-2]", ("1-1", "1-2", "2-1", "2-2")),
        ("alice", ("alice",)),
    ],
)
def test_ranges_are_expanded(text: str, names: tuple[str, ...]) -> None:
    assert expand_names(text) == names


@pytest.mark.parametrize(
    "text",
    [
        "",
        "r[",
        "r1]",
        "r[]",
        "r[a-b]",
        "tb3-0[23]",  # 2 and 3, or 23?
        "r[3-1]",
        "r[1-99999]",
        "r[1-2000],x[1-2000]",
        "Anna",
        "a,,b",
        "a,a",
        "r[1-2],r2",
        "r[[1-2]]",
        "r[1-]",
        "r[-2]",
        "../etc",
    ],
)
def test_wrong_names_are_refused(text: str) -> None:
    with pytest.raises(ConfigError):
        expand_names(text)


def test_names_are_chosen_by_name_range_and_glob() -> None:
    known = ("r1", "r2", "r10", "alice")
    assert select_names((), known) == known
    assert select_names(("r[1-2]", "r1"), known) == ("r1", "r2")
    assert select_names(("r*",), known) == ("r1", "r2", "r10")
    for wrong in ("r[1-3]", "x*", "bob"):
        with pytest.raises(ConfigError):
            select_names((wrong,), known)


def test_a_name_has_one_role() -> None:
    check_distinct(("a",), ("b",))
    with pytest.raises(ConfigError, match="two roles"):
        check_distinct(("a", "b"), ("b",))


@pytest.mark.parametrize(
    ("name", "suggested"),
    [("warn", "mine.py:warm"), ("mine:warm", "mine.py:warm"), ("gather_tine", "gather_time")],
)
def test_an_unknown_name_is_answered_with_the_nearest_also_after_a_colon(
    name: str, suggested: str
) -> None:
    assert unknown("metric", name, ("gather_time", "mine.py:warm", "x")).endswith(
        f"did you mean {suggested!r}?"
    )


def test_names_of_the_user_come_first_where_none_is_near() -> None:
    text = unknown("metric", "misspelt", ("alpha", "mine.py:warm", "beta"))
    assert text.endswith("there are: mine.py:warm, alpha, beta")
