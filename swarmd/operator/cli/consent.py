"""Asks the user for confirmation before robots are changed."""

from __future__ import annotations

import sys

import click


def has_terminal() -> bool:
    """True if a person can answer: the standard input is open, and a terminal."""
    return sys.stdin is not None and sys.stdin.isatty()


def need_consent(what: str, to_check: str, question: str) -> None:
    """Ask before robots are changed: UsageError without a terminal, ClickException after a no."""
    if not has_terminal():
        raise click.UsageError(
            f"{what} asks for confirmation, and there is no terminal; nothing was sent; check that"
            f" {to_check}, and add --yes"
        )
    if not click.confirm(question, err=True):
        raise click.ClickException("nothing was sent")
