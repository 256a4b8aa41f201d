"""Carries out commands of pages on a living swarm, by the client code of swarmctl."""

from __future__ import annotations

import asyncio
import threading
from collections.abc import Callable, Iterable, Mapping
from contextlib import ExitStack
from functools import partial
from typing import Any, Literal

from swarmd.core.clock import boottime
from swarmd.core.errors import NetworkError, SwarmError
from swarmd.core.numbers import exact_number
from swarmd.operator.client.hand_over import in_thread
from swarmd.operator.client.operator_pool import RequestLimit
from swarmd.operator.session.operator import Operator
from swarmd.operator.session.outcome import Outcome
from swarmd.operator.session.session import Session, TargetedView
from swarmd.operator.session.targets import Targets
from swarmd.operator.texts.assignments import read_assignments
from swarmd.operator.verbs.drive.ask import Hand, take
from swarmd.operator.verbs.label.ask import change_labels
from swarmd.operator.verbs.label.words import read_changes
from swarmd.operator.verbs.param.ask import set_params
from swarmd.operator.verbs.push.ask import Push, push_to, source_named
from swarmd.operator.verbs.run.ask import Run, carry_out, goal_targets_of_names
from swarmd.operator.verbs.stop import words as stop_words
from swarmd.operator.verbs.stop.ask import reset, send_stop
from swarmd.operator.view.source import CommandProgress

Tell = Callable[[CommandProgress], None]
Sender = Callable[[TargetedView, ExitStack], Outcome]
"""Sends a request to its targets. The exit stack closes what the request opens."""

MAX_STOPS = 16
"""Stops under way at a time; more wait. An emergency stop never waits."""


class LiveCommander:
    """Carries out commands of pages, each with an operator and a thread of its own.

    `known`: the robots that pages show; a stop of all robots expects a reply of each. `reason`: a
    text that robots store with each emergency stop and reset.

    1. An emergency stop is repeated until all robots have acknowledged it, another emergency stop
       begins, or `end_estop` is called.
    2. Requests that wait for answers delay neither a stop nor the end of the program.
    3. When a page closes, its tasks of `act` are cancelled. A cancelled task sends no further
       request, but a stop under way goes on.
    """

    def __init__(
        self,
        make: Callable[[], Operator],
        known: Callable[[], Iterable[str]] = tuple,
        reason: str = "from the page",
    ) -> None:
        self._make = make
        self._known = known
        self._reason = reason
        self._limit = RequestLimit()
        self._stops = asyncio.Semaphore(MAX_STOPS)
        self._ending = threading.Event()

    def close(self) -> None:
        """End the emergency stop under way; requests end by themselves."""
        self.end_estop()

    def end_estop(self) -> None:
        """Stop repeating the emergency stop, even if acknowledgements are missing."""
        self._ending.set()

    def take(self, robot: str) -> Hand:
        """Take a robot by hand, for the stick of a page; blocks. SwarmError if it refuses."""
        asked_at = boottime()
        with ExitStack() as opened:
            operator = opened.enter_context(self._make())
            operator.expect((robot,))
            targeted = Session(operator, began=asked_at).target(
                Targets((robot,)), needs_status=False
            )
            hand = take(operator, targeted.view, robot, issued=asked_at)
            hand.on_close = opened.pop_all().close
        return hand

    async def act(self, verb: str, fields: Mapping[str, Any], tell: Tell) -> None:
        """Carry out a command; `tell` gets the answers as they come, the last one final."""
        loop = asyncio.get_running_loop()

        def tell_later(answer: CommandProgress) -> None:
            loop.call_soon_threadsafe(tell, answer)

        ending = threading.Event()  # no emergency stop is repeated, and no request is sent
        try:
            work = self._carry_out(verb, dict(fields), tell_later, ending)
            if verb == "estop":
                self.end_estop()
                self._ending = ending
                answer = await in_thread(work)
            elif verb == "stop":
                async with self._stops:
                    answer = await in_thread(work)
            else:
                answer = await _unless_cancelled(work, ending)
            tell(answer)
        except Exception as error:  # the page must not show that it is under way
            tell(CommandProgress(f"{verb}: {str(error) or type(error).__name__}", is_final=True))
            if not isinstance(error, SwarmError | ValueError | TypeError):
                raise

    def _carry_out(
        self, verb: str, fields: dict[str, Any], tell: Tell, ending: threading.Event
    ) -> Callable[[], CommandProgress]:
        """The work of a command, for a thread. Raises ValueError or TypeError for a wrong one."""
        targets = fields.get("targets")
        names = None if targets is None else tuple(map(str, targets))
        if verb not in ("estop", "stop", "run", "param", "reset", "label", "push", "fetch"):
            raise ValueError(f"there is no command {verb!r}")
        if verb == "fetch":
            incident = str(fields.get("incident") or "")
            if not incident:
                raise ValueError("no incident was named")
            return lambda: self._fetch(incident, tell, ending)
        if isinstance(targets, str) or names == ():
            raise ValueError("no robot was targeted")
        if verb == "estop" or verb == "stop":
            return lambda: self._stop("estop" if verb == "estop" else "stop", names, tell, ending)
        if names is None:
            raise ValueError("no robot was targeted")
        chosen = names
        clicked_at = boottime()
        return lambda: self._request(verb, chosen, fields, tell, ending, clicked_at)

    def _stop(
        self,
        verb: Literal["stop", "estop"],
        names: tuple[str, ...] | None,
        tell: Tell,
        ending: threading.Event,
    ) -> CommandProgress:
        def on_progress(missing: tuple[str, ...]) -> None:
            text = stop_words.not_acknowledged(verb, missing)
            tell(CommandProgress(text, missing=list(missing)))

        with self._make() as operator:
            operator.expect(self._known())
            outcome = send_stop(
                Session(operator, is_cancelled=ending.is_set),
                verb,
                Targets(names or ()),
                self._reason if verb == "estop" else "",
                until_all=verb == "estop",
                on_progress=on_progress,
            )
        return _answer(verb, outcome)

    def _request(
        self,
        verb: str,
        names: tuple[str, ...],
        fields: Mapping[str, Any],
        tell: Tell,
        cancelled: threading.Event,
        clicked_at: float,
    ) -> CommandProgress:
        """Send a request of a page to robots and wait for their replies; runs in a thread.

        `verb`: run, param, reset, label or push. `names`: the robots that the page shows or has
        selected. `tell` gets lines for the user meanwhile.
        `fields`: the texts that the user typed. `cancelled` ends the wait for robots. `clicked_at`:
        s on the clock since boot. Returns the final answer for the page; ConfigError for a mistake
        in a text.
        """
        send = self._sender(verb, names, fields)  # parses the texts before anything is sent
        with self._limit.request(), self._make() as operator, ExitStack() as opened:
            operator.expect(names)  # a robot that does not answer counts as missing
            session = Session(
                operator,
                tell=_teller(verb, tell),
                is_cancelled=cancelled.is_set,
                began=clicked_at,
            )
            try:
                targeted = session.target(Targets(names), needs_status=verb in ("reset", "label"))
            except NetworkError as error:
                return CommandProgress(f"{verb}: {error}", missing=list(names), is_final=True)
            outcome = send(targeted, opened)
        return _answer(verb, outcome)

    def _fetch(self, incident: str, tell: Tell, cancelled: threading.Event) -> CommandProgress:
        """Copy what robots keep of an incident to the machine of this server; runs in a thread."""
        # Few pages fetch.
        from swarmd.operator.verbs.incidents.ask import ask_incidents, fetch, incident_named

        with self._limit.request(), self._make() as operator:
            operator.expect(self._known())
            session = Session(operator, tell=_teller("fetch", tell), is_cancelled=cancelled.is_set)
            found = ask_incidents(session)
            fetched = fetch(session, found, incident_named(found, incident))
        copies = [(one.robot, one.state, str(one.path)) for one in fetched.files]
        line = f"fetch: {len(copies)} copied to {fetched.folder.absolute()}"
        is_good = bool(fetched)
        return CommandProgress(line, copies, list(fetched.missing), is_good, is_final=True)

    def _sender(self, verb: str, names: tuple[str, ...], fields: Mapping[str, Any]) -> Sender:
        """Parse the texts of a request; returns a function that sends the request."""
        params = read_assignments(str(fields.get("params") or "").split(), "parameters:")
        match verb:
            case "run":
                run = Run(pattern=str(fields.get("pattern")), params=params)
                run.check()
                return partial(_send_run, run, names)
            case "param":
                return lambda targeted, _: set_params(targeted, params)
            case "push":
                push = _push_of(fields)
                return partial(_send_push, push, names)
            case "label":
                added, removed = read_changes(str(fields.get("labels") or "").split())
                return lambda targeted, _: change_labels(targeted, added, removed)
            case _:
                return lambda targeted, _: reset(targeted, reason=self._reason)


def _send_run(
    run: Run, names: tuple[str, ...], targeted: TargetedView, opened: ExitStack
) -> Outcome:
    """Run a pattern. `names`: the robots that the page names."""
    targets = goal_targets_of_names(targeted.view, names)
    return carry_out(run, targeted, targets, opened).outcome


def _push_of(fields: Mapping[str, Any]) -> Push:
    """The push of a page. `code`: the bytes of the file that came; `size`: those that it has."""
    code = fields.get("code")
    size = fields.get("size")
    source = source_named(
        str(fields.get("file") or ""),
        code if isinstance(code, bytes) else b"",
        size if isinstance(size, int) else 0,
    )
    canary = str(fields.get("canary") or "")
    count = exact_number(canary)
    push = Push(
        source,
        canary=(count if isinstance(count, int) else canary) if canary else None,
        replace=fields.get("replace") is True,
        rerun=fields.get("rerun") is True,
    )
    push.check()
    return push


def _send_push(
    push: Push, names: tuple[str, ...], targeted: TargetedView, opened: ExitStack
) -> Outcome:
    """Push a pattern. `names`: as of `_send_run`."""
    is_for_all = targeted.view.expected <= set(names)
    return push_to(push, targeted, Targets(() if is_for_all else names))


def _teller(verb: str, tell: Tell) -> Callable[[str], object]:
    """Shows lines for the user, of a command that takes long, until its final answer."""
    if verb not in ("push", "fetch"):
        return lambda text: None
    return lambda text: tell(CommandProgress(f"{verb}: {text}"))


async def _unless_cancelled(
    work: Callable[[], CommandProgress], cancelled: threading.Event
) -> CommandProgress:
    """The result of `work`, run on a thread, which is told if the task is cancelled."""
    try:
        return await in_thread(work)
    except asyncio.CancelledError:
        cancelled.set()
        raise


def _answer(verb: str, outcome: Outcome) -> CommandProgress:
    replies = [
        (name, reply.code.value, reply.text) for name, reply in sorted(outcome.replies.items())
    ]
    return CommandProgress(
        f"{verb}: {outcome.line}",
        replies,
        list(outcome.missing),
        is_good=outcome.exit_code == 0,
        is_final=True,
    )
