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
from swarmd.operator.client.changes import change_labels, reset, set_params
from swarmd.operator.client.hand_over import in_thread
from swarmd.operator.client.operator_pool import RequestLimit
from swarmd.operator.client.runs import Run, carry_out
from swarmd.operator.client.session import Session, TargetedView
from swarmd.operator.client.stops import send_stop
from swarmd.operator.client.targets import Targets
from swarmd.operator.session.operator import Operator
from swarmd.operator.session.outcome import Outcome
from swarmd.operator.texts.assignments import read_assignments
from swarmd.operator.texts.labels import read_changes
from swarmd.operator.verbs.drive.ask import Hand, take
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
        if verb not in ("estop", "stop", "run", "param", "reset", "label"):
            raise ValueError(f"there is no command {verb!r}")
        if isinstance(targets, str) or names == ():
            raise ValueError("no robot was targeted")
        if verb == "estop" or verb == "stop":
            return lambda: self._stop("estop" if verb == "estop" else "stop", names, tell, ending)
        if names is None:
            raise ValueError("no robot was targeted")
        chosen = names
        clicked_at = boottime()
        return lambda: self._request(verb, chosen, fields, ending, clicked_at)

    def _stop(
        self,
        verb: Literal["stop", "estop"],
        names: tuple[str, ...] | None,
        tell: Tell,
        ending: threading.Event,
    ) -> CommandProgress:
        def on_progress(missing: tuple[str, ...]) -> None:
            tell(CommandProgress(f"{verb}: {len(missing)} not acknowledged", missing=list(missing)))

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
        cancelled: threading.Event,
        clicked_at: float,
    ) -> CommandProgress:
        """Send a request of a page to robots and wait for their replies; runs in a thread.

        `verb`: run, param, reset or label. `names`: the robots that the page shows or has selected.
        `fields`: the texts that the user typed. `cancelled` ends the wait for robots. `clicked_at`:
        s on the clock since boot. Returns the final answer for the page; ConfigError for a mistake
        in a text.
        """
        send = self._sender(verb, names, fields)  # parses the texts before anything is sent
        with self._limit.request(), self._make() as operator, ExitStack() as opened:
            operator.expect(names)  # a robot that does not answer counts as missing
            session = Session(operator, is_cancelled=cancelled.is_set, began=clicked_at)
            try:
                targeted = session.target(Targets(names), needs_status=verb in ("reset", "label"))
            except NetworkError as error:
                return CommandProgress(f"{verb}: {error}", missing=list(names), is_final=True)
            outcome = send(targeted, opened)
        return _answer(verb, outcome)

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
            case "label":
                added, removed = read_changes(str(fields.get("labels") or "").split())
                return lambda targeted, _: change_labels(targeted, added, removed)
            case _:
                return lambda targeted, _: reset(targeted, reason=self._reason)


def _send_run(
    run: Run, names: tuple[str, ...], targeted: TargetedView, opened: ExitStack
) -> Outcome:
    """Run a pattern. `names`: the robots that the page names.

    If the page names all robots, the goal names none: the goal then also targets robots that join
    later.
    """
    is_for_all = targeted.view.expected <= set(names)
    return carry_out(run, targeted, () if is_for_all else names, opened).outcome


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
