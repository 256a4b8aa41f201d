"""Requests to robots: the swarm as seen, the robots that must answer, the outcome reported.

The outcome is a line for each robot, a count, and the exit code.
"""

from __future__ import annotations

import sys
from collections.abc import Collection, Iterable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Literal, NoReturn

import click
from msgspec.structs import replace

from swarmd.cli.options import Failure
from swarmd.cli.output import fields, print_json, print_table, warn
from swarmd.cli.targets import (
    STOP_LOOK,
    Targets,
    named,
    no_target,
    robots_of,
    stopped,
    targets_of,
    unlabelled,
)
from swarmd.client.known_robots import remember
from swarmd.core.errors import unknown
from swarmd.core.messages import Code, Refusal
from swarmd.network.exit_codes import UNREACHABLE, code_of_answers
from swarmd.network.operator.outcome import Outcome
from swarmd.texts.values import NOTHING, seconds

if TYPE_CHECKING:
    from swarmd.cli.options import CommonOptions
    from swarmd.core.verbs import AnyRequest
    from swarmd.network.operator.members_view import MembersView
    from swarmd.network.operator.operator import Operator

# What a request has at least of `--timeout`, in s: it is sent even if the look took too long.
LEAST_REQUEST_TIME = 0.02
# Where the operator finds what all robots refused as a mistake.
_HELP = {
    Refusal.UNKNOWN_PATTERN: "swarmctl patterns",
    Refusal.INVALID_PARAMETER: "swarmctl patterns show NAME",
    Refusal.INVALID_CONDITION: "swarmctl run --help",
}


def known_members(
    options: CommonOptions,
    operator: Operator,
    *,
    is_request_next: bool = False,
    needs_status: bool = True,
) -> MembersView:
    """The swarm, once all have answered or after `--timeout`; says what is missing on stderr.

    With `is_request_next` half of `--timeout` is left for a request (see `time_left`). Failure,
    naming the swarms that were found, if no daemon was reached.
    """
    timeout = options.timeout
    if timeout is not None and is_request_next:
        timeout /= 2.0
    view = operator.members(timeout=timeout, needs_status=needs_status)
    _tell_notices(operator)
    remember(operator.settings, view)
    if not view.members:
        raise unreachable(operator)
    warn_of_gaps(view, view.missing)
    return view


def _tell_notices(operator: Operator) -> None:
    for text in operator.notices:
        warn(text)
    operator.notices.clear()


def time_left(options: CommonOptions, view: MembersView) -> float | None:
    """What the look has left of `--timeout` for a request, in s; None without `--timeout`."""
    if options.timeout is None:
        return None
    return max(options.timeout - view.seconds, LEAST_REQUEST_TIME)


@dataclass(frozen=True, slots=True)
class Asked:
    """The robots `names` that requests of a verb are for, in the swarm as `view` shows it.

    `unlabelled`: robots that may be targets by a label, since theirs are not known.
    """

    options: CommonOptions
    operator: Operator
    view: MembersView
    names: tuple[str, ...]
    unlabelled: tuple[str, ...]

    def request(
        self, kind: type[AnyRequest], names: Collection[str] | None = None, **fields: Any
    ) -> Outcome:
        """The outcome of a request to all targets or `names`, in what `--timeout` has left."""
        epochs = self.view.epochs(self.names if names is None else names)
        return self.operator.request(
            kind, epochs, timeout=time_left(self.options, self.view), **fields
        )

    def show(self, outcome: Outcome) -> Outcome:
        """Print the outcome, and return it as it counts: with robots whose labels are not known."""
        outcome = replace(outcome, unlabelled=self.unlabelled)
        show(self.options, outcome)
        return outcome

    def report(self, outcome: Outcome, notes: Mapping[str, Any] | None = None) -> NoReturn:
        """Print the outcome and end with its exit code. `notes`: more, for JSON."""
        report(self.options, replace(outcome, unlabelled=self.unlabelled), notes)


@contextmanager
def asking(options: CommonOptions, targets: Targets, *, needs_status: bool) -> Iterator[Asked]:
    """A session in the swarm after a look, and the targets of requests; Failure if there are none.

    Half of `--timeout` is left for requests. Targets by label need statuses in any case.
    """
    with options.operator() as operator:
        view = known_members(
            options,
            operator,
            is_request_next=True,
            needs_status=needs_status or bool(targets.labels),
        )
        names = targets_of(view, targets)
        yield Asked(options, operator, view, names, unlabelled(view, targets))


def unreachable(operator: Operator, sent: str = "") -> Failure:
    """The error of a swarm in which no robot was reached; `sent`: what was sent nevertheless."""
    text = f"no daemon of swarm {operator.settings.swarm!r} can be reached{sent}"
    return Failure(f"{text}{_instead(operator)}", UNREACHABLE)


def _instead(operator: Operator) -> str:
    """What is heard in place of a swarm in which no robot was reached."""
    swarm, profile, found = operator.settings.swarm, operator.settings.profile, operator.swarms()
    if swarm in found:
        keys = "has no keys for it (--identity)" if operator.identity is None else "has other keys"
        return f"; there is a swarm of that name, and this swarmctl {keys} or another profile"
    if found:
        return f"; there are the swarms: {', '.join(found)} (see --swarm)"
    start = "swarmd, or `swarmctl sim up` for a simulated swarm" if profile == "dev" else "swarmd"
    return f", nor any other swarm {_where(operator)}; start {start}; or see --profile"


def warn_of_gaps(view: MembersView, missing: Iterable[str]) -> None:
    """Say on stderr which of the expected robots did not answer, and what is known of them."""
    lines = [gap(view, name) for name in missing]
    if lines:
        warn(f"view not complete: {'; '.join(lines)}")


def gap(view: MembersView, name: str) -> str:
    """What is known of a robot that did not answer."""
    from swarmd.texts.why import absence

    return f"{name} {absence(view.members.get(name))}"


def exit_code_of(view: MembersView, names: Collection[str]) -> int:
    """The exit code of a look at the robots in `names`: 0, 3 if some answered, 5 if none."""
    return code_of_answers(names, view.answered)


def named_now(options: CommonOptions, operator: Operator, targets: Targets) -> Targets:
    """The targets by name alone, as a look shows labels now. For verbs that follow robots."""
    return named(known_members(options, operator), targets) if targets.labels else targets


def send_to(
    options: CommonOptions, kind: type[AnyRequest], targets: Targets, **fields: Any
) -> NoReturn:
    """Send a request to the targets and report."""
    with asking(options, targets, needs_status=False) as asked:
        asked.report(asked.request(kind, **fields))


def send_stop(
    options: CommonOptions,
    verb: Literal["stop", "estop"],
    targets: Targets,
    reason: str = "",
    *,
    until_all: bool = False,
) -> NoReturn:
    """Stop the targets at once and report; a full name that no robot has does not answer.

    Failure if no daemon was reached or no robot is targeted.
    """

    with options.operator() as operator:
        if targets.labels:
            look = STOP_LOOK if options.timeout is None else min(options.timeout / 2, STOP_LOOK)
            view = operator.members(timeout=look)
            unclear = unlabelled(view, targets)
            targets = stopped(view, targets)
            if unclear:
                warn(f"labels are not known, a stop is sent to them, too: {', '.join(unclear)}")

        def on_progress(missing: tuple[str, ...]) -> None:
            view = operator.seen()
            lines = [gap(view, name) for name in missing] or ["a robot to be heard"]
            warn(f"waiting for {'; '.join(lines)}")

        def send() -> Outcome:
            return operator.send_stop(
                verb,
                select=None if targets.is_whole_swarm else targets.matching,
                names=targets.full_names,
                reason=reason,
                timeout=options.timeout,
                until_all=until_all,
                on_progress=on_progress,
            )

        before = operator.identity
        outcome = send()
        if outcome.missing or not outcome.replies:
            operator.update_roster()
            if operator.identity is not before:  # robots may have heard nothing of it
                outcome = send()
        _tell_notices(operator)
        view = operator.seen()
        if not outcome.reached and not outcome.replies and not view.roster:
            how = f"`{verb}` was sent {_where(operator)} for {seconds(outcome.seconds)}"
            raise unreachable(operator, f"; {how} and no robot answered")
        known = view.members.keys() | view.roster | outcome.replies.keys()
        lost = [name for name in outcome.missing if name not in known]
        if not outcome.targeted or len(lost) == outcome.targeted:
            names = robots_of(view, targets)
            raise no_target(*(f"{name} has left" for name in names))
        if not outcome.reached and not outcome.replies:
            warn(f"no robot was heard{_instead(operator)}")
        warn_of_gaps(view, [name for name in outcome.missing if name not in lost])
        warnings = (unknown("robot", name, view.members) for name in lost)
        report(options, replace(outcome, warnings=(*outcome.warnings, *warnings)))


def stop_on_interrupt(operator: Operator, names: Collection[str]) -> None:
    """Stop these robots as the verb is interrupted, and say on stderr which of them stopped."""
    warn(f"interrupted: stop sent: {stop_names(operator, names).line}")


def stop_names(operator: Operator, names: Collection[str]) -> Outcome:
    """Stop these robots, within 5 s."""
    chosen = set(names)
    return operator.send_stop(
        "stop", select=lambda found: tuple(chosen & set(found)), names=tuple(names), timeout=5.0
    )


def report(
    options: CommonOptions, outcome: Outcome, notes: Mapping[str, Any] | None = None
) -> NoReturn:
    """Print the outcome of a request and end with its exit code. `notes`: more, for JSON."""
    show(options, outcome, notes)
    click.get_current_context().exit(outcome.exit_code)


def show(options: CommonOptions, outcome: Outcome, notes: Mapping[str, Any] | None = None) -> None:
    """Print the outcome of a request, and the mistake in it if robots refused one."""
    for line in outcome.warnings:
        warn(f"warning: {line}")
    if outcome.unlabelled:
        names = ", ".join(outcome.unlabelled)
        warn(f"view not complete: the labels of {names} are not known; repeat it")
    if outcome.unlisted:
        names = ", ".join(outcome.unlisted)
        warn(f"view not complete: {names} did not list the robots that it knows; repeat it")
    for name in outcome.duplicates:
        warn(f"warning: {name} answered twice: two daemons have this id; stop one of them")
    error = _mistake(outcome)
    try:
        if options.is_json:
            print_json("Outcome", {**_as_json(outcome), "error": error, **(notes or {})})
        else:
            if rows := _rows(outcome):
                print_table(("NAME", "ANSWER", "TEXT"), rows)
            click.echo(outcome.line)
        if options.is_json or sys.stdout is None:
            warn(outcome.line)
    except OSError:  # what was applied must not be lost with the answer
        warn(outcome.line)
        raise
    if error:
        warn(f"error: {error}")


def _mistake(outcome: Outcome) -> str | None:
    """The mistake of the operator that robots refused, and where to look it up."""
    if not outcome.mistake:
        return None
    refusal = next(iter(outcome.replies.values())).refusal
    name = click.get_current_context().params.get("pattern", "NAME")
    see = f" (see {_HELP[refusal]})".replace("NAME", name) if refusal in _HELP else ""
    return f"{outcome.mistake}{see}"


def _rows(outcome: Outcome) -> list[tuple[str, str, str]]:
    """A row for each robot that applied it; each reason of others once, with their names."""
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
    """What is known of a robot that did not answer; it denies silently what it does not permit."""
    return "no answer or not permitted" if name in outcome.mute else NOTHING


def _where(operator: Operator) -> str:
    settings = operator.settings
    if settings.profile == "routed":
        return f"through {', '.join(settings.routers)}"
    return "on this machine" if settings.profile == "dev" else f"by {settings.interface}"


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
