"""Requests and questions of an operator on their way: repeated until each robot has replied."""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterable, Mapping

from msgspec.structs import replace

from swarmd.core import codec
from swarmd.core.clock import boottime
from swarmd.core.codec import MAX_CONTROL, Decoder, encode, version_of
from swarmd.core.keys import ANY, CONTROL
from swarmd.core.messages import Code, Epoch, Refusal, Reply, ReplyHeader
from swarmd.core.verbs import (
    AnyRequest,
)
from swarmd.network.operator.arrivals import Arrivals
from swarmd.network.operator.discovery import Discovery
from swarmd.network.operator.members_view import MembersView
from swarmd.network.operator.operator_sessions import OperatorSessions
from swarmd.network.operator.outcome import Acks, Outcome

# A request without a reply is repeated after this time, in s: a congested or closing link loses it.
REPEAT_PERIOD = 0.5
# A request waits for the sum of these three by default, see discovery.py.
REQUEST_WAIT = 5.0  # s
REQUEST_TRIPS = 8.0  # round trips
REQUEST_LOSS_WAIT = 15.0  # s, times the loss
REQUEST_CAP = 45.0  # or `least`, if that is longer
# How often a request looks for links that have come up, in s.
LINK_PERIOD = 0.003


_reply_header = Decoder(ReplyHeader, any_version=True)
_reply = Decoder(Reply, MAX_CONTROL)


def request_timeout(view: MembersView, least: float) -> float:
    """How long a request waits for replies, in s: `least`, and more by the trip and the loss."""
    timeout = least + REQUEST_TRIPS * view.round_trip + REQUEST_LOSS_WAIT * view.loss
    return min(timeout, max(least, REQUEST_CAP))


def aged(request: AnyRequest, age: float) -> AnyRequest:
    """The request `age` s after its operator issued it; the age counts for its goal, too.

    Only requests with a field `age` count from when their operator issued them, as stops do.
    """
    return replace(request, age=age) if "age" in request.__struct_fields__ else request


class RequestSender:
    """Sends by the sessions of an operator."""

    def __init__(self, sessions: OperatorSessions, arrivals: Arrivals) -> None:
        self._sessions = sessions
        self._arrivals = arrivals

    def send(
        self,
        request: AnyRequest,
        targets: Mapping[str, Epoch | None],
        asked: Collection[str],
        view: MembersView,
        discovery: Discovery | None,
        timeout: float,
        is_ended: Callable[[], bool] = lambda: False,
    ) -> tuple[Outcome, set[str]]:
        """Send to those of `targets` that are `asked`; the outcome, and the robots with a link.

        `view`: the last look. Robots without a link yet are dialled as `discovery` finds them. It
        waits no longer once `is_ended`, asked after each wait.
        """
        others = set(asked) & set(view.of_other_version())
        acks = Acks(request.id)
        patience = min(timeout, 1.0 + 6.0 * view.round_trip)
        started = now = boottime()
        links = self._sessions.question_links(request.verb)
        unlinked = set(asked) if self._sessions.needs_links else set[str]()
        robots = tuple(asked)
        repeat_at = now
        while robots and (left := started + timeout - now) > 0:
            linked = self._sessions.linked(links, unlinked)
            unlinked -= linked
            is_due = now >= repeat_at
            if is_due or linked:
                repeat_at = now + REPEAT_PERIOD if is_due else repeat_at
                asking = set(robots) - unlinked if is_due else linked
                payload = encode(aged(request, now - started + view.round_trip))
                for robot in (ANY,) if len(asking) == len(asked) else sorted(asking):
                    self._sessions.get(robot, CONTROL, request.verb, payload, left, _collect(acks))
            if unlinked and discovery is not None:
                self._sessions.dial(discovery, now, only=unlinked)
            pause = min(left, repeat_at - now, LINK_PERIOD if unlinked else REPEAT_PERIOD)
            with self._arrivals.lock:
                self._arrivals.lock.wait_for(lambda: not acks.missing(asked), max(pause, 0.001))
                robots, now = acks.missing(asked), boottime()
            if is_ended():
                break
            if now - started >= patience and others.issuperset(robots):
                break  # they may not know how to refuse it
        links.close()
        with self._arrivals.lock:
            for name in acks.missing(others):
                acks.on_reply(name, _refused(request.id, name, view.members[name].wire))
            outcome = acks.outcome(targets, seconds=now - started, reached=len(asked))
        return outcome, set(asked) - unlinked

    def ask(
        self, robots: Iterable[str], name: str, payload: bytes, timeout: float
    ) -> dict[str, bytes]:
        """The answers to `control/<name>` of those of `robots` that did answer."""
        asked, answers = sorted(set(robots)), dict[str, bytes]()
        until = boottime() + timeout
        while len(answers) < len(asked) and (left := until - boottime()) > 0:
            for robot in asked:
                if robot not in answers:
                    self._sessions.get(robot, CONTROL, name, payload, left, answers.setdefault)
            with self._arrivals.lock:
                self._arrivals.lock.wait_for(
                    lambda: len(answers) == len(asked), min(left, REPEAT_PERIOD)
                )
        with self._arrivals.lock:
            return dict(answers)


def _collect(acks: Acks) -> Callable[[str, bytes], object]:
    """Take a reply of this version, and what can be read of another version's."""

    def take(robot: str, payload: bytes) -> None:
        if version_of(payload) == codec.VERSION:
            acks.on_reply(robot, _reply(payload))
            return
        header = _reply_header(payload)
        reply = Reply(
            id=header.id,
            robot=header.robot,
            code=Code.REFUSED,
            refusal=Refusal.OTHER_VERSION,
            text=header.text,
        )
        acks.on_reply(robot, reply)

    return take


def _refused(request: str, robot: str, wire: int | None) -> Reply:
    """The refusal of a robot of another version that did not refuse the request itself."""
    return Reply(
        id=request,
        robot=robot,
        code=Code.REFUSED,
        refusal=Refusal.OTHER_VERSION,
        text=f"{robot} speaks {'another' if wire is None else wire}, this swarmctl {codec.VERSION}",
    )
