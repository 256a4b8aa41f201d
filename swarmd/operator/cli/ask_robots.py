"""Queries of verbs to several robots that change nothing; warns of missing answers."""

from __future__ import annotations

from collections.abc import Collection, Iterable
from typing import TYPE_CHECKING, Any, TypeVar

import click
from msgspec import Struct

from swarmd.operator.cli.output import warn
from swarmd.operator.cli.send import session_of
from swarmd.operator.session import session as client
from swarmd.operator.session.exit_codes import code_of_answers

if TYPE_CHECKING:
    from swarmd.core.verbs import Verb
    from swarmd.operator.cli.options import CommonOptions
    from swarmd.operator.session.operator import Operator

T = TypeVar("T", bound=client.Answer)


def ask_robots(
    options: CommonOptions,
    operator: Operator,
    robots: Iterable[str],
    verb: Verb[Any, T],
    question: Struct | None = None,
) -> dict[str, T]:
    """The answers to a question, by robot; warns of an answer that cannot be read."""
    return client.ask_robots(session_of(options, operator), robots, verb, question)


def end(robots: Collection[str], answered: Collection[str]) -> None:
    """Warn of robots without an answer; end with 3 if some robots answered, 5 if none did."""
    missing = sorted(set(robots) - set(answered))
    if missing:
        warn(f"no answer: {', '.join(missing)}")
        click.get_current_context().exit(code_of_answers(robots, answered))
