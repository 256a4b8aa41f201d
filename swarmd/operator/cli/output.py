"""Output of swarmctl: results on stdout as tables or JSON, everything else on stderr."""

from __future__ import annotations

import contextlib
import os
import signal
import sys
from collections.abc import Iterator, Mapping, Sequence
from itertools import zip_longest
from typing import Any

import click

from swarmd.operator.texts.values import printable

API_VERSION = "swarm/v1"

_COLOURS = {
    "running": "green",
    "at rest": "green",
    "held": "yellow",
    "applied": "green",
    "alive": "green",
    "estopped": "red",
    "faulted": "red",
    "failed": "red",
    "silent": "red",
    "refused": "red",
    "no answer": "red",
    "fault": "red",
    "warning": "yellow",
    "stopped": "yellow",
    "left": "yellow",
}


def print_json(kind: str, content: Mapping[str, Any], indent: int | None = 2) -> None:
    """Print a JSON document with its kind and the version of the format.

    `indent` None: on one line, for verbs that follow (NDJSON).
    """
    click.echo(_json_text({"apiVersion": API_VERSION, "kind": kind, **content}, indent))


def fields(one: object, *names: str) -> dict[str, Any]:
    """The attributes `names` of a value, for JSON."""
    return {name: getattr(one, name) for name in names}


def print_table(
    header: Sequence[str], rows: Sequence[Sequence[str]], *, width: int | None = None
) -> None:
    """Print aligned columns; states in colour on a terminal, unless NO_COLOR is set.

    If a line is longer than `width` characters, its last column is cut between words.
    """
    is_coloured = has_colour(sys.stdout is not None and sys.stdout.isatty())
    if width is not None:
        used = [max(map(len, column)) + 2 for column in zip(header, *rows, strict=True)][:-1]
        room = max(width - sum(used), len(header[-1]))
        from swarmd.core.verbs import shortened  # `--help` reads no message

        rows = [(*row[:-1], shortened(row[-1], room)) for row in rows]
    for line in table_lines(header, rows, is_coloured=is_coloured):
        click.echo(line, color=is_coloured)


def line_width() -> int | None:
    """The columns of the terminal; None for a file or a pipe, whose lines are not cut."""
    return terminal_width() if sys.stdout is not None and sys.stdout.isatty() else None


def terminal_width() -> int:
    """$COLUMNS, or the columns of the terminal; 80 without these. shutil's takes 4 ms to import."""
    with contextlib.suppress(OSError, ValueError):
        return int(os.environ.get("COLUMNS") or os.get_terminal_size().columns) or 80
    return 80


def table_lines(
    header: Sequence[str],
    rows: Sequence[Sequence[str]],
    *,
    is_coloured: bool = False,
    least: Sequence[int] = (),
) -> list[str]:
    """Aligned columns, each as wide as its texts, and as `least` in the order of the columns."""
    rows = [[printable(text) for text in row] for row in rows]
    widths = [max(map(len, column)) for column in zip(header, *rows, strict=True)]
    widths = [max(pair) for pair in zip_longest(widths, least[: len(widths)], fillvalue=0)]
    return [
        "  ".join(map(_cell, row, widths, [is_coloured] * len(widths))).rstrip()
        for row in (header, *rows)
    ]


def print_section(title: str, rows: Sequence[tuple[str, str]]) -> None:
    """Print a heading and `name  value` lines; nothing if there are no lines."""
    if not rows:
        return
    width = max(len(name) for name, _ in rows)
    click.echo(title)
    for name, value in rows:
        click.echo(printable(f"  {name.ljust(width)}  {value}"))


def warn(text: str) -> None:
    """Print a line on stderr; a failure is ignored, so that the answer on stdout does not fail."""
    with contextlib.suppress(OSError):
        click.echo(printable(text), err=True)


def rewrite(text: str) -> None:
    """Replace the present line of a terminal on stderr; without a terminal, print the line."""
    if sys.stderr.isatty():
        line = printable(text)[: terminal_width() - 1]  # a line that wraps is not replaced
        click.echo(f"\r\x1b[K{line}", err=True, nl=False)
    elif text:
        warn(text)


def has_colour(is_terminal: bool) -> bool:
    """True on a terminal with colours, unless NO_COLOR is set (no-color.org)."""
    return is_terminal and not os.environ.get("NO_COLOR") and os.environ.get("TERM") != "dumb"


def _json_text(document: Mapping[str, Any], indent: int | None) -> str:
    """JSON in which characters that could control the terminal are escaped."""
    import json  # 1 ms of the start, and most answers are for people

    text = json.dumps(document, indent=indent, ensure_ascii=False, allow_nan=False)
    if text.isascii() and "\x7f" not in text:
        return text
    return "".join(
        char if char == "\n" or char.isprintable() else json.dumps(char)[1:-1] for char in text
    )


def _cell(text: str, width: int, is_coloured: bool) -> str:
    padded = text.ljust(width)
    colour = _COLOURS.get(text) if is_coloured else None
    return click.style(padded, fg=colour) if colour else padded


def need_terminal(verb: str, instead: str) -> None:
    """Raise UsageError without a terminal, or with a terminal without a cursor."""
    streams = (sys.stdin, sys.stdout)  # None: it was closed before the start
    if not all(stream is not None and stream.isatty() for stream in streams):
        raise click.UsageError(f"{verb} needs a terminal; {instead}")
    if os.environ.get("TERM", "dumb") == "dumb":
        raise click.UsageError(f"{verb} needs a terminal whose cursor moves (TERM); {instead}")


@contextlib.contextmanager
def signals_end(*numbers: signal.Signals) -> Iterator[None]:
    """A context in which signals, by default SIGTERM and SIGHUP, end the program.

    A signal raises SystemExit with 128 plus its number, so that `finally` blocks run.
    """

    def end(number: int, _: object) -> None:
        raise SystemExit(128 + number)

    before = {
        number: signal.signal(number, end) for number in numbers or (signal.SIGTERM, signal.SIGHUP)
    }
    try:
        yield
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)
