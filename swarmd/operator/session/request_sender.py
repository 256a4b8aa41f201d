"""Sends the requests and queries of an operator, and repeats them until each robot has replied."""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterable, Mapping, Sequence

from msgspec.structs import replace

from swarmd.core import codec
from swarmd.core.clock import boottime
from swarmd.core.codec import MAX_CONTROL, Decoder, encode, version_of
from swarmd.core.keys import ANY, CONTROL
from swarmd.core.messages import Code, Epoch, Reply, ReplyHeader
from swarmd.core.refusal import Refusal
from swarmd.core.verbs import AnyRequest, starts_motion
from swarmd.operator.session.arrivals import Arrivals
from swarmd.operator.session.discovery import Discovery
from swarmd.operator.session.loop_watch import LoopWatch
from swarmd.operator.session.members_view import MembersView
from swarmd.operator.session.operator_sessions import OperatorSessions
from swarmd.operator.session.outcome import Acks, Outcome

# s after which a request without a reply is repeated: a congested or closing link may lose it.
REPEAT_PERIOD = 0.5
# By default a request waits for the sum of the first three, at most for REQUEST_CAP.
REQUEST_WAIT = 5.0  # s
REQUEST_TRIPS = 8.0  # round trips, as measured by `discovery.py`
REQUEST_LOSS_WAIT = 15.0  # s, times the share of solicits that were lost
REQUEST_CAP = 45.0  # s
# s between two checks for new links while a robot has none.
LINK_PERIOD = 0.003
LEAST_PAUSE = 0.001  # s for which the sender waits in any case before it sends again
# s, and round trips, after which robots of another version are not waited for.
OTHER_VERSION_WAIT = 1.0
OTHER_VERSION_TRIPS = 6.0


_reply_header = Decoder(ReplyHeader, any_version=True)
_reply = Decoder(Reply, MAX_CONTROL)


def request_timeout(view: MembersView, least_timeout: float) -> float:
    """Seconds for which a request waits for replies; they grow with round trip and loss.

    At least `least_timeout`, and at most the greater of REQUEST_CAP and `least_timeout`.
    """
    timeout = least_timeout + REQUEST_TRIPS * view.round_trip + REQUEST_LOSS_WAIT * view.loss
    return min(timeout, max(least_timeout, REQUEST_CAP))


class RequestSender:
    """Sends by the sessions of an operator."""

    def __init__(self, sessions: OperatorSessions, arrivals: Arrivals, loops: LoopWatch) -> None:
        self._sessions = sessions
        self._arrivals = arrivals
        self._loops = loops

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
        """Send a request to the robots in `asked`, and repeat it until all have replied.

        Each copy gets its age when it is sent: the s since `request.issued` on the own clock.
        `targets`: all robots that the outcome is about; targets that are not in `asked` count as
        missing. `view`: the members by the last look (query of all members). Robots without a Zenoh
        link are dialled as `discovery` finds them. Sending ends after `timeout` s, or once
        `is_ended` returns True. If only robots of another version are missing, which may never
        reply, sending ends after a short time. A start is not sent again after this process stood
        still (`loop_watch.py`): the outcome has a warning then. Returns the outcome, and the robots
        in `asked` with a link.
        """
        of_other_version = set(asked) & set(view.of_other_version())
        other_version_wait = OTHER_VERSION_WAIT + OTHER_VERSION_TRIPS * view.round_trip
        acks = Acks(request.id)
        started = now = boottime()
        repeat_at = now  # the first query is due at once
        links = self._sessions.question_links(request.verb)  # which robots a query would reach
        unlinked = set(asked) if self._sessions.needs_links else set[str]()
        missing = tuple(asked)
        pause = 0.0
        stood = 0.0
        self._loops.begin(now)
        while missing and (time_left := started + timeout - now) > 0:
            newly_linked = self._sessions.linked(links, unlinked)
            unlinked -= newly_linked
            receivers = newly_linked
            if now >= repeat_at:
                repeat_at = now + REPEAT_PERIOD
                receivers = set(missing) - unlinked
            # One query to all robots replaces many: robots that are no targets ignore the query.
            names = [ANY] if len(receivers) == len(asked) else sorted(receivers)
            # With the age at its arrival: a robot refuses a start that is too old.
            age = now - request.issued + view.round_trip
            present_request = replace(request, age=age)
            self._query(present_request, names, time_left, acks)
            if unlinked and discovery is not None:
                self._sessions.dial(discovery, now, only=unlinked)
            pause = min(time_left, repeat_at - now, LINK_PERIOD if unlinked else REPEAT_PERIOD)
            pause = max(pause, LEAST_PAUSE)
            with self._arrivals.lock:
                self._arrivals.lock.wait_for(lambda: not acks.missing(asked), pause)
                missing = acks.missing(asked)
                now = boottime()
            stood = self._loops.turn(now, pause) if starts_motion(request) else 0.0
            lacks_only_other_version = of_other_version.issuperset(missing)
            is_in_vain = lacks_only_other_version and now - started >= other_version_wait
            if stood or is_ended() or is_in_vain:
                break
        links.close()
        with self._arrivals.lock:
            if stood:  # replies that came meanwhile are handed over only now
                self._arrivals.lock.wait_for(lambda: not acks.missing(asked), REPEAT_PERIOD)
            # A robot of another version that has not replied counts as refusing.
            for name in acks.missing(of_other_version):
                acks.on_reply(name, _refused(request.id, name, view.members[name].wire))
            outcome = acks.outcome(targets, seconds=now - started, reached=len(asked))
        if stood and outcome.missing:
            outcome = replace(
                outcome,
                warnings=(stood_still(stood, "it was not sent again; see which robots run"),),
            )
        return outcome, set(asked) - unlinked

    def _query(
        self, request: AnyRequest, robots: Sequence[str], timeout: float, acks: Acks
    ) -> None:
        """Send the request to each robot in `robots` (ANY: to all); the replies go to `acks`."""
        if not robots:
            return
        payload = encode(request)
        for robot in robots:
            self._sessions.get(robot, CONTROL, request.verb, payload, timeout, _collect(acks))

    def ask(
        self, robots: Iterable[str], name: str, payload: bytes, timeout: float
    ) -> dict[str, bytes]:
        """The answers to the query `control/<name>`, by robot, within `timeout` s.

        Robots that did not answer are left out.
        """
        asked = sorted(set(robots))
        answers = dict[str, bytes]()
        until = boottime() + timeout
        self._loops.begin(boottime())
        while len(answers) < len(asked) and (time_left := until - boottime()) > 0:
            for robot in asked:
                if robot not in answers:  # `setdefault`: the first answer of a robot counts
                    self._sessions.get(robot, CONTROL, name, payload, time_left, answers.setdefault)
            with self._arrivals.lock:
                self._arrivals.lock.wait_for(
                    lambda: len(answers) == len(asked), min(time_left, REPEAT_PERIOD)
                )
            self._loops.turn(boottime(), REPEAT_PERIOD)
        with self._arrivals.lock:
            return dict(answers)


def stood_still(seconds: float, consequence: str) -> str:
    """The line for the user after this process stood still."""
    text = f"this program stood still for {seconds:.1f} s (stopped, or its computer suspended)"
    return f"{text}: {consequence}"


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
    """The refusal that stands for the missing reply of a robot of another version."""
    return Reply(
        id=request,
        robot=robot,
        code=Code.REFUSED,
        refusal=Refusal.OTHER_VERSION,
        text=f"{robot} speaks {'another' if wire is None else wire}, this swarmctl {codec.VERSION}",
    )
