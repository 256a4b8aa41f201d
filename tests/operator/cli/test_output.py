"""Tables, sections, JSON and colours."""

from __future__ import annotations

import json
import sys

import click
import pytest

from swarmd.core.verbs import shortened
from swarmd.operator.cli.output import (
    has_colour,
    line_width,
    need_terminal,
    print_json,
    print_section,
    print_table,
)
from swarmd.operator.texts.values import counted, seconds


def test_a_table_is_aligned_and_plain_without_a_terminal(
    capsys: pytest.CaptureFixture[str],
) -> None:
    print_table(("NAME", "STATE"), [("r1", "running"), ("robot-2", "failed")])
    assert capsys.readouterr().out == "NAME     STATE\nr1       running\nrobot-2  failed\n"


@pytest.mark.parametrize(
    ("text", "length", "cut"),
    [
        ("no pattern", 10, "no pattern"),
        ("no pattern 'x'; there are: a, bc", 30, "no pattern 'x'; there are..."),
        ("no pattern at", 13, "no pattern at"),
        ("no pattern at all", 13, "no pattern..."),
        ("inseparable", 8, "insep..."),
    ],
)
def test_a_text_is_cut_between_words(text: str, length: int, cut: str) -> None:
    assert shortened(text, length) == cut


@pytest.mark.parametrize(("count", "text"), [(0, "0 robots"), (1, "1 robot"), (2, "2 robots")])
def test_one_thing_is_singular(count: int, text: str) -> None:
    assert counted(count, "robot") == text


@pytest.mark.parametrize("is_terminal", [True, False])
def test_lines_are_cut_on_a_terminal_alone(
    monkeypatch: pytest.MonkeyPatch, *, is_terminal: bool
) -> None:
    monkeypatch.setenv("COLUMNS", "90")
    monkeypatch.setattr("sys.stdout.isatty", lambda: is_terminal)
    assert line_width() == (90 if is_terminal else None)


def test_without_standard_output_there_is_no_terminal(monkeypatch: pytest.MonkeyPatch) -> None:
    for name in ("stdin", "stdout"):  # closed before the start, such as by `>&-`
        monkeypatch.setattr(sys, name, None)
    assert line_width() is None
    with pytest.raises(click.UsageError, match="needs a terminal"):
        need_terminal("view", "")


def test_an_empty_section_is_left_out(capsys: pytest.CaptureFixture[str]) -> None:
    print_section("Nothing", [])
    print_section("Some", [("a", "1"), ("long", "2")])
    assert capsys.readouterr().out == "Some\n  a     1\n  long  2\n"


@pytest.mark.parametrize(
    ("is_terminal", "variables", "expected"),
    [
        (True, {}, True),
        (False, {}, False),
        (True, {"NO_COLOR": "1"}, False),
        (True, {"NO_COLOR": ""}, True),
        (True, {"TERM": "dumb"}, False),
    ],
)
def test_colours_only_on_a_terminal_that_wants_them(
    monkeypatch: pytest.MonkeyPatch,
    is_terminal: bool,
    variables: dict[str, str],
    expected: bool,
) -> None:
    monkeypatch.delenv("NO_COLOR", raising=False)
    monkeypatch.setenv("TERM", "xterm")
    for name, value in variables.items():
        monkeypatch.setenv(name, value)
    assert has_colour(is_terminal) is expected


@pytest.mark.parametrize(
    ("value", "text"),
    [
        (0.0, "0 ms"),
        (0.0041, "4 ms"),
        (0.9999, "1.0 s"),
        (38.0, "38.0 s"),
        (600.0, "10 min"),
        (9000.0, "2 h"),
    ],
)
def test_time_spans_are_short(value: float, text: str) -> None:
    assert seconds(value) == text


def test_texts_of_robots_cannot_control_the_terminal(capsys: pytest.CaptureFixture[str]) -> None:
    print_table(["ROBOT"], [["tb3\x1b[2J\n"]])
    print_section("Events", [("now", "by \x1b]0;mine\x07")])
    printed = capsys.readouterr().out
    assert "\x1b" not in printed
    assert "tb3?[2J?" in printed


def test_json_cannot_control_the_terminal(capsys: pytest.CaptureFixture[str]) -> None:
    texts = ["\x1b[2J", "\x9b2J", "\x7f", "\u202egnp", "\u2028", "\U000e0001", "Straße"]
    print_json("Texts", {"texts": texts})
    print_json("Texts", {"texts": texts}, indent=None)
    printed = capsys.readouterr().out
    assert all(char.isprintable() or char == "\n" for char in printed)
    assert "Straße" in printed
    assert json.loads(printed.splitlines()[-1])["texts"] == texts
