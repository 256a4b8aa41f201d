"""A session of an operator: looks at a swarm, and the targets of requests."""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterable
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

from msgspec.structs import replace

from swarmd.core.clock import boottime
from swarmd.core.closing import is_program_on
from swarmd.core.errors import NetworkError, SwarmError, unknown
from swarmd.operator.session.dials import Dials
from swarmd.operator.session.known_robots import remember
from swarmd.operator.session.targets import Targets, named, targets_of, unlabelled

if TYPE_CHECKING:
    from swarmd.core.verbs import AnyRequest
    from swarmd.operator.session.members_view import MembersView
    from swarmd.operator.session.operator import Operator
    from swarmd.operator.session.outcome import Outcome

# What a request has at least of `timeout`, in s: it is sent even if the look took too long.
LEAST_REQUEST_TIME = 0.02


@dataclass(frozen=True, slots=True)
class Session:
    """An operator's session for one verb, such as `run` or `members`.

    `timeout`: the longest time in s that the verb takes. `tell` takes lines for the user.
    `is_cancelled` returns True once the caller no longer waits; a verb that waits then ends.
    `is_owned` returns False once nobody waits for what a lease of this session keeps going: by
    default from the end of the main thread on.
    `began`: when the user typed, clicked or called the verb, in s on the clock since boot. A robot
    that was stopped since then refuses to start a run.
    """

    operator: Operator
    timeout: float | None = None
    tell: Callable[[str], object] = lambda text: None
    is_cancelled: Callable[[], bool] = lambda: False
    began: float = field(default_factory=boottime)
    is_owned: Callable[[], bool] = is_program_on

    def look(
        self, *, is_request_next: bool = False, needs_status: bool = True, dials: Dials = Dials.ALL
    ) -> MembersView:
        """Query all members (a look), and tell the user which robots are missing.

        Returns once all expected robots have answered, or after the session's `timeout`.
        `is_request_next`: the look ends after half of `timeout`, so that `time_left` is left for a
        request. `needs_status` False: a robot has also answered if its beacon was heard.
        `dials`: see `Operator.members`; NONE: without statuses.

        NetworkError if no daemon was reached; the text names the swarms that were heard. SwarmError
        if a request is next, and its caller no longer waits.
        """
        timeout = self.timeout
        if timeout is not None and is_request_next:
            timeout /= 2.0
        view = self.operator.members(
            timeout=timeout, needs_status=needs_status and dials is not Dials.NONE, dials=dials
        )
        self.tell_notices()
        remember(self.operator.settings, view)
        if not view.members:
            raise unreachable(self.operator)
        self.tell_gaps(view, view.missing)
        if is_request_next:
            self.check_awaited()
        return view

    def check_awaited(self) -> None:
        """Raise SwarmError if the caller no longer waits or the connection is closed."""
        if self.is_cancelled():
            raise SwarmError(
                "not sent: its caller, its event loop or the main thread has ended, or the"
                " connection was closed"
            )

    def time_left(self, view: MembersView) -> float | None:
        """Seconds of `timeout` that the look has left for a request; None without `timeout`."""
        if self.timeout is None:
            return None
        return max(self.timeout - view.seconds, LEAST_REQUEST_TIME)

    def target(self, targets: Targets, *, needs_status: bool) -> TargetedView:
        """A look, and the targets of requests; RequestError if there are none.

        Half of `timeout` is left for requests. Targets by label need statuses in any case.
        """
        view = self.look(is_request_next=True, needs_status=needs_status or bool(targets.labels))
        names = targets_of(view, targets)
        return TargetedView(self, view, names, unlabelled(view, targets))

    def named_now(self, targets: Targets) -> Targets:
        """The targets with labels replaced by names, by a look now.

        For verbs that follow robots.
        """
        return named(self.look(), targets) if targets.labels else targets

    def tell_awaited(self, view: MembersView, targets: Targets) -> None:
        """Report whom a following verb waits for: any robot, or a name that no robot has."""
        known = view.members.keys() | view.roster
        if not view.members:
            self.tell("no robot is heard yet")
        for glob in targets.names if known else ():
            if not Targets((glob,)).matching(known):
                self.tell(f"{unknown('robot', glob, known)}; waits for it")

    def tell_notices(self) -> None:
        """Report the operator's notices about rosters."""
        for text in self.operator.notices:
            self.tell(text)
        self.operator.notices.clear()

    def tell_gaps(self, view: MembersView, missing: Iterable[str]) -> None:
        """Report the expected robots that did not answer, and what is known of them."""
        lines = [gap(view, name) for name in missing]
        if lines:
            self.tell(f"view not complete: {'; '.join(lines)}")


@dataclass(frozen=True, slots=True)
class TargetedView:
    """The target robots `names` of a verb's requests, and the look `view` that showed them.

    `unlabelled`: robots whose labels are not known, so that they may be targets of a label.
    """

    session: Session
    view: MembersView
    names: tuple[str, ...]
    unlabelled: tuple[str, ...] = ()

    @property
    def operator(self) -> Operator:
        """The operator of the session."""
        return self.session.operator

    @property
    def time_left(self) -> float | None:
        """Seconds of the timeout that the look has left."""
        return self.session.time_left(self.view)

    def request(
        self, kind: type[AnyRequest], names: Collection[str] | None = None, **fields: Any
    ) -> Outcome:
        """Send a request to all targets, or to `names`, in the time that is left; the outcome."""
        epochs = self.view.epochs(self.names if names is None else names)
        began = self.session.began
        return self.operator.request(kind, epochs, timeout=self.time_left, issued=began, **fields)

    def counted(self, outcome: Outcome) -> Outcome:
        """The outcome with the `unlabelled` robots: its exit code is then PARTIAL at best."""
        return replace(outcome, unlabelled=self.unlabelled)


def unreachable(operator: Operator, sent: str = "") -> NetworkError:
    """The error for a swarm in which no robot was reached; `sent`: what was sent nevertheless."""
    text = f"no daemon of swarm {operator.settings.swarm!r} can be reached{sent}"
    return NetworkError(f"{text}{other_swarms(operator)}")


def other_swarms(operator: Operator) -> str:
    """The other swarms that were heard, in words, when no robot was reached."""
    swarm = operator.settings.swarm
    profile = operator.settings.profile
    found = operator.swarms()
    if swarm in found:
        keys = "has no keys for it (--identity)" if operator.identity is None else "has other keys"
        return f"; there is a swarm of that name, and this swarmctl {keys} or another profile"
    if found:
        return f"; there are the swarms: {', '.join(found)} (see --swarm)"
    start = "swarmd, or `swarmctl sim up` for a simulated swarm" if profile == "dev" else "swarmd"
    return f", nor any other swarm {where(operator)}; start {start}; or see --profile"


def where(operator: Operator) -> str:
    """The network in which an operator looks, in words."""
    settings = operator.settings
    if settings.profile == "routed":
        return f"through {', '.join(settings.routers)}"
    return "on this machine" if settings.profile == "dev" else f"by {settings.interface}"


def gap(view: MembersView, name: str) -> str:
    """What is known of a robot that did not answer, in words."""
    from swarmd.operator.texts.why import absence  # most looks lack no robot

    return f"{name} {absence(view.members.get(name))}"
