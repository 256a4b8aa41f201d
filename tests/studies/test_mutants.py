"""Mutants of commits: which places are changed, and how."""

from __future__ import annotations

import ast

import pytest

from studies.mutants import mutate, of_commits, places, touched

SOURCE = """\
ENDS_RUN = frozenset({Kind.WHEEL_DROP, Kind.LIFTED})
LIMIT = 0.5


def far(x):
    return x > LIMIT and x is not None


def near(x):
    return not far(x) or x in (1.0, 2.0)
"""


def changes(lines: set[int]) -> list[str]:
    """By number of the place, what its mutant changes."""
    found = []
    for number in touched(SOURCE, lines):
        node, function = list(places(ast.parse(SOURCE)))[number]
        found.append(f"{function}: {mutate(node)}")
    return found


def test_a_table_loses_an_entry() -> None:
    assert changes({1}) == [": without Kind.WHEEL_DROP"]


def test_all_of_a_function_is_changed_whose_line_was_touched() -> None:
    assert sorted(changes({6})) == ["far: > to <=", "far: and to or", "far: is not to is"]


def test_other_functions_stay() -> None:
    assert sorted(changes({9})) == [
        "near: 1.0 to 1.5",
        "near: 2.0 to 3.0",
        "near: in to not in",
        "near: or to and",
    ]
    assert changes({3}) == []


def test_commits_that_are_not_there_are_named() -> None:
    with pytest.raises(SystemExit, match=r"no commits 'nowhere\^!'"):
        of_commits("nowhere")
