"""Sends the requests and queries of an operator, and repeats them until each robot has replied."""

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

# s after which a request without a reply is repeated: a congested or closing link may lose it.
REPEAT_PERIOD = 0.5
# By default a request waits for the sum of the first three, at most for REQUEST_CAP.
REQUEST_WAIT = 5.0  # s
REQUEST_TRIPS = 8.0  # round trips, as measured by `discovery.py`
REQUEST_LOSS_WAIT = 15.0  # s, times the share of solicits that were lost
REQUEST_CAP = 45.0  # s
# s between two checks for new links while a robot has none.
LINK_PERIOD = 0.003
# s, and round trips, after which robots of another version are not waited for.
OTHER_VERSION_WAIT, OTHER_VERSION_TRIPS = 1.0, 6.0


_reply_header = Decoder(ReplyHeader, any_version=True)
_reply = Decoder(Reply, MAX_CONTROL)


def request_timeout(view: MembersView, least: float) -> float:
    """Seconds for which a request waits for replies: `least`, longer by round trip and loss.

    At most REQUEST_CAP, or `least` if that is longer.
    """
    timeout = least + REQUEST_TRIPS * view.round_trip + REQUEST_LOSS_WAIT * view.loss
    return min(timeout, max(least, REQUEST_CAP))


def aged(request: AnyRequest, age: float) -> AnyRequest:
    """The request with its `age`, in s since its operator issued it.

    A kind of request without the field `age` is returned as it is.
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
        """Send a request to the robots in `asked`, until all have replied.

        Returns the outcome for `targets`, and the robots in `asked` with a link. Robots without a
        link are dialled as `discovery` finds them. The wait ends after `timeout` s, or once
        `is_ended` returns True. `view`: the last look; robots of another version in it are waited
        for only a short time, since they may not reply.
        """
        of_other_version = set(asked) & set(view.of_other_version())
        acks = Acks(request.id)
        patience = min(timeout, OTHER_VERSION_WAIT + OTHER_VERSION_TRIPS * view.round_trip)
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
            if now - started >= patience and of_other_version.issuperset(robots):
                break
        links.close()
        with self._arrivals.lock:
            for name in acks.missing(of_other_version):
                acks.on_reply(name, _refused(request.id, name, view.members[name].wire))
            outcome = acks.outcome(targets, seconds=now - started, reached=len(asked))
        return outcome, set(asked) - unlinked

    def ask(
        self, robots: Iterable[str], name: str, payload: bytes, timeout: float
    ) -> dict[str, bytes]:
        """The answers to the query `control/<name>`, by robot, within `timeout` s.

        Robots that did not answer are left out.
        """
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
    """The handler of replies; a reply of another version counts as refused, with its text."""

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
    """The reply in place of that of a robot of another version that did not reply."""
    return Reply(
        id=request,
        robot=robot,
        code=Code.REFUSED,
        refusal=Refusal.OTHER_VERSION,
        text=f"{robot} speaks {'another' if wire is None else wire}, this swarmctl {codec.VERSION}",
    )
