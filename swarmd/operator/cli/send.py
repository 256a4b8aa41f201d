"""Sends requests to robots on the command line, prints the outcome, and ends with its exit code."""

from __future__ import annotations

import sys
from collections.abc import Collection, Iterator, Mapping
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any, NoReturn

import click
from msgspec import Struct

from swarmd.core.messages import Code
from swarmd.core.refusal import Refusal
from swarmd.operator.cli.output import fields, print_json, print_table, warn
from swarmd.operator.session.exit_codes import code_of_answers
from swarmd.operator.session.members_view import Dials
from swarmd.operator.session.outcome import Outcome
from swarmd.operator.session.session import Session, TargetedView
from swarmd.operator.texts.values import NOTHING

if TYPE_CHECKING:
    from swarmd.core.verbs import AnyRequest
    from swarmd.operator.cli.options import CommonOptions
    from swarmd.operator.session.members_view import MembersView
    from swarmd.operator.session.operator import Operator
    from swarmd.operator.session.targets import Targets

# Where the operator finds what all robots refused as a mistake.
_HELP = {
    Refusal.UNKNOWN_PATTERN: "swarmctl patterns; robots get yours by swarmctl plugin push FILE",
    Refusal.INVALID_PARAMETER: "swarmctl patterns show NAME",
    Refusal.INVALID_CONDITION: "swarmctl run --help",
}


def session_of(options: CommonOptions, operator: Operator) -> Session:
    """The session of a verb: lines for the user are warnings."""
    return Session(operator, options.timeout, warn, began=options.began)


def known_members(
    options: CommonOptions,
    operator: Operator,
    *,
    is_request_next: bool = False,
    needs_status: bool = True,
    dials: Dials = Dials.ALL,
) -> MembersView:
    """Query all members, and tell the user which robots are missing; returns the members.

    `is_request_next`: half of the time is left for a request. `needs_status` False: a robot has
    also answered if its beacon was heard. `dials`: see `Operator.members`; NONE: without statuses.
    """
    session = session_of(options, operator)
    return session.look(is_request_next=is_request_next, needs_status=needs_status, dials=dials)


class Asked(Struct, frozen=True):
    """The targets of a verb, with the session, for requests whose outcomes are printed."""

    options: CommonOptions
    targeted: TargetedView

    @property
    def operator(self) -> Operator:
        """Who asks."""
        return self.targeted.operator

    @property
    def view(self) -> MembersView:
        """The swarm as the look has shown it."""
        return self.targeted.view

    @property
    def names(self) -> tuple[str, ...]:
        """The robots that must answer."""
        return self.targeted.names

    def show(self, outcome: Outcome) -> Outcome:
        """Print the outcome, and return it as it counts: with robots whose labels are not known."""
        outcome = self.targeted.counted(outcome)
        show(self.options, outcome)
        return outcome

    def report(self, outcome: Outcome, notes: Mapping[str, Any] | None = None) -> NoReturn:
        """Print the outcome and end with its exit code. `notes`: more, for JSON."""
        report(self.options, self.targeted.counted(outcome), notes)


@contextmanager
def asking(options: CommonOptions, targets: Targets, *, needs_status: bool) -> Iterator[Asked]:
    """A session in the swarm after a query of all members, and the targets of requests.

    RequestError if no robot is a target. Half of the time is left for requests.
    """
    with options.operator() as operator:
        session = session_of(options, operator)
        yield Asked(options, session.target(targets, needs_status=needs_status))


def exit_code_of(view: MembersView, names: Collection[str]) -> int:
    """The exit code of a look at the robots in `names`: 0, 3 if some answered, 5 if none."""
    return code_of_answers(names, view.answered)


def send_to(
    options: CommonOptions, kind: type[AnyRequest], targets: Targets, **fields: Any
) -> NoReturn:
    """Send a request to the targets and report."""
    with asking(options, targets, needs_status=False) as asked:
        asked.report(asked.targeted.request(kind, **fields))


def report(
    options: CommonOptions, outcome: Outcome, notes: Mapping[str, Any] | None = None
) -> NoReturn:
    """Print the outcome of a request and end with its exit code. `notes`: more, for JSON."""
    show(options, outcome, notes)
    click.get_current_context().exit(outcome.exit_code)


def show(options: CommonOptions, outcome: Outcome, notes: Mapping[str, Any] | None = None) -> None:
    """Print the outcome of a request: warnings, the answers of robots, and a summary line.

    If robots refused the request because of a mistake of the operator, a line with the mistake
    follows. `notes`: further fields of the JSON document. OSError if standard output fails, such as
    a full disk.
    """
    _warn_of_view(outcome)
    mistake = _mistake(outcome)
    # JSON has no summary line, and a program without standard output prints nothing.
    lacks_line = options.is_json or sys.stdout is None
    try:
        if options.is_json:
            print_json("Outcome", {**_as_json(outcome), "error": mistake, **(notes or {})})
        else:
            if rows := _rows(outcome):
                print_table(("NAME", "ANSWER", "TEXT"), rows)
            click.echo(outcome.line)
        if lacks_line:
            warn(outcome.line)
    except OSError:  # the operator must learn what robots have applied
        warn(outcome.line)
        raise
    if mistake:
        warn(f"error: {mistake}")


def _warn_of_view(outcome: Outcome) -> None:
    """Print the warnings of an outcome, also about robots that the request may have left out."""
    for text in outcome.warnings:
        warn(f"warning: {text}")
    if outcome.unlabelled:  # these robots may have a target label
        names = ", ".join(outcome.unlabelled)
        warn(f"view not complete: the labels of {names} are not known; repeat it")
    if outcome.unlisted:
        names = ", ".join(outcome.unlisted)
        warn(f"view not complete: {names} did not list the robots that it knows; repeat it")
    for robot in outcome.duplicates:
        warn(f"warning: {robot} answered twice: two daemons have this id; stop one of them")


def _mistake(outcome: Outcome) -> str | None:
    """The mistake of the operator that robots refused, and the verb that shows valid values."""
    if not outcome.mistake:
        return None
    refusal = next(iter(outcome.replies.values())).refusal
    name = click.get_current_context().params.get("pattern", "NAME")
    see = f" (see {_HELP[refusal]})".replace("NAME", name) if refusal in _HELP else ""
    return f"{outcome.mistake}{see}"


def _rows(outcome: Outcome) -> list[tuple[str, str, str]]:
    """A row for each robot that applied it; each other answer once, with its robots."""
    by_reason: dict[tuple[str, str], list[str]] = {}
    rows = []
    for name, reply in outcome.replies.items():
        if reply.code is Code.APPLIED:
            rows.append((name, reply.code.value, reply.text or NOTHING))
        elif not outcome.mistake:  # the error says that
            by_reason.setdefault((reply.code.value, reply.text), []).append(name)
    for name in outcome.missing:
        by_reason.setdefault(("no answer", _silence(name, outcome)), []).append(name)
    for (answer, text), names in by_reason.items():
        if len(names) == 1:
            rows.append((names[0], answer, text or NOTHING))
        else:
            rows.append((f"{len(names)} robots", answer, f"{text or NOTHING}: {', '.join(names)}"))
    return sorted(rows)


def _silence(name: str, outcome: Outcome) -> str:
    """Why a robot may not have answered, in words.

    A robot does not answer a request that the operator's role forbids.
    """
    return "no answer or not permitted" if name in outcome.mute else NOTHING


def _as_json(outcome: Outcome) -> dict[str, Any]:
    return {
        "verb": click.get_current_context().command_path.partition(" ")[2],
        **fields(outcome, "targeted", "applied", "refused", "failed", "missing"),
        **fields(outcome, "line", "exit_code"),
        "seconds": round(outcome.seconds, 4),
        "replies": {
            name: fields(reply, "code", "refusal", "text")
            for name, reply in outcome.replies.items()
        },
        "warnings": outcome.warnings,
    }
