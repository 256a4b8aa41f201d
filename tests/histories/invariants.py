"""What holds at each step of every history of a swarm, and of every sequence of one robot.

`RULES` has the rules: each with its name, a sentence for people, and the functions that judge
histories. The judges of sequences (`tests/sequences`) carry these names, too. What the sentences
leave open:

- `stopped`: a robot that answers a stop or an emergency stop with `applied` stands at that moment
  and loads nothing. It moves again only by a request that an operator sent after the robot had
  obeyed that stop, or by a goal with `on_join: run` that was set later than the stop. A robot
  refuses no stop that was issued later than its run began.
- `late_start`: the age counts from the moment at which the order was typed, without the time for
  which its operator's program worked (a program that stands still does not work) and the time
  until a start that was ordered for later. Judged in histories by the true times.
- `answer`: `applied` to a run or resume: the pattern runs. To a reset: the robot is not estopped,
  and the named latches are gone. To a goal: the robot holds it or a greater one. To labels: it has
  them.
- `old_goal`: a robot that joins does so within the goal's `valid` and `seconds`, counted from the
  moment at which its operator set it (AGE_SHIFT beside it), and the goal is later than each stop,
  emergency stop and reset that the robot has obeyed, in this life and in the earlier ones whose
  disk it has kept; and than each stop of all robots that was obeyed by the robot from which it
  learned of the goal.
- `agreement`: all hold the same goal and the same swarm-wide latches. A robot is estopped exactly
  if it holds a latch. A robot runs its own goal, or was asked for a run without one after it came.
- `cause`: the end has a reason, and a line among the robot's events. A stop ends no run that was
  asked for after it was issued, and makes no goal to stand that follows a goal which was set later.
  (Of two goals, the greater one ends the run of the other.)
- `latch`: a latch goes with a reset that names it, or with the disk. What was reset is held again
  only by the operator's own copy of the emergency stop, or by an older disk.
- `handed_on`: a robot relays no stop beyond its minute, no emergency stop that it has reset, and no
  stop of all that is older than the run of all whose goal it holds.
- `storm`: at most MAX_SENT datagrams.
- `program`: no robot takes a message in the name of a robot that it knows, or more of a sender on a
  channel within a second than the limits allow.
- `still_pose`: at most STANDING_WAY by one request of an operator, in one life of the daemon.
- `lost_base`: after a loss of more than LOSS_TIME only a run that began after it moves the robot.
- `lease`: the time counts from the last renewal that the operator has sent, or from the arrival of
  its own request of the run, and the way of a datagram beside it.
- `unmoved`: the state, the epoch, latches, goal and pattern of the robot and its command are the
  same before and after its black box has worked.
- `heard`: judged on the incidents of the last WINDOW s that a robot tells when all is healed,
  unless six of the same origin came before. A robot that told some which never happened is not
  judged, and neither are its true ones: they share the budget of its lies.
- `fair`: a mark of an operator is one that the robot got from the operator itself: the swarm of
  incidents has no signatures.
- `few`: the death of the own daemon may follow an incident at once.
- `death`: the minute before the death is in the file. Judged if the daemon had worked for a second,
  and if the next one works long enough to write it.

The time that a stop is on its way adds nothing to its age: no clocks are compared. So it may seem
later than it was, by the delay of each of its hops, and never earlier: in doubt it acts. So does
that of a Zenoh program by the time for which its query waits in a daemon that stalls, since a query
has no stamp of its arrival. A request may seem earlier than it was, by the way of the beacon by
which its operator knows the clock of the robot. The rules `cause` and `handed_on` count these times
(`_unseen_by`, `_unseen_age`).

A robot that starts with an empty or an older disk has forgotten what it obeyed: it counts as a new
robot for the rules `stopped` and `old_goal`, and is bound by what its peers tell before it is
ready.
"""

from __future__ import annotations

import logging
import math
import traceback
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

from swarmd.core.errors import CoreFault
from swarmd.core.goal import Goal, GoalState
from swarmd.core.incident import Incident, IncidentKind
from swarmd.core.message_limits import CHANNEL_BURST, CHANNEL_RATE
from swarmd.core.messages import Code, Reason, Reply, State
from swarmd.core.verbs import (
    EstopRequest,
    GoalRequest,
    KeptIncident,
    LabelRequest,
    Request,
    ResetRequest,
    ResumeRequest,
    RunRequest,
    StopRequest,
)
from swarmd.daemon.recording.incident_file import IncidentHead
from swarmd.link.datagram import Datagram, Stop
from swarmd.link.spread.goal_sync import FoundGoal
from swarmd.link.stops.stop_relay import LIFETIME

if TYPE_CHECKING:  # the sequences of one robot need no network
    from tests.histories.black_box import Death
    from tests.histories.swarm import Cause, VirtualDaemon, VirtualSwarm

AGE_SHIFT = 0.5  # s by which the age of a goal or a stop may be wrong
MAX_START_AGE = 5.0  # s
LATE = 25.0  # s for which an operator repeats a stop
HEAL_TIME = 10.0  # s
STANDING_WAY = 0.25  # m
ROUNDING = 0.005  # s: a stop counts its age in ms, rounded by each robot that hands it on
LEASE_SHIFT = 0.5  # s: a command that is sent at a tick, and the load of the pattern of a run
MOST_WAYS = 1.5  # of a lease, in greatest delays: a datagram takes up to 1.2 of them
LOSS_TIME = 3.5  # s: a hold ends a run after 2 s, and the daemon may stall for 1 s meanwhile
HISTORIES = 10_200
"""Random histories: 100 in `make test`, the others in `make evidence`."""
LEASE_HISTORIES = 1000
"""Those that the rule `lease`, which is newer, has judged so far."""
TELL_TIME = 50.0  # s: a pull over a cut link takes 20 s, the next one may wait 10 s, a file 10 s
WINDOW = 50.0  # s: a robot takes an incident that is up to 100 s old
INCIDENT_GAP, INCIDENTS_AN_HOUR, INCIDENT_FILES = 10.0, 6, 20
RING_LAG = 0.4  # s between the last entry of a ring and a death, at most: a tick at rest
MAX_SENT = 300  # datagrams of one robot within a second


class BrokenRuleError(AssertionError):
    """A rule does not hold; `rule`: its name in `RULES`."""

    def __init__(self, rule: str, text: str) -> None:
        assert rule in RULES, f"{rule} is no rule"
        super().__init__(f"rule {rule}: {text}")
        self.rule = rule


@dataclass(slots=True)
class _Memory:
    """What a robot has obeyed, on the disk that it has now. Times are true ones, in s."""

    stopped: float = -1.0  # when the latest stop that it obeyed was issued
    obeyed: float = -1.0  # when it obeyed a stop last
    told: float = -1.0  # when the latest stop of which it was told was issued
    resumed: tuple[str, float] = (
        "",
        -1.0,
    )  # the goal of the last request that began a run, its time
    stopped_all: float = -1.0  # as `stopped`, of the stops of all robots
    reset: float = -1.0  # when it was reset last
    held: frozenset[str] = frozenset()
    cleared: set[str] = field(default_factory=set)
    state: State = State.IDLE
    was_running: bool = False
    runs: Cause | None = None
    began: float = 0.0  # when its run began
    lost: float = -1.0  # when its base was lost last
    barred: float = -1.0  # a run that began before this may not go on: its base was lost for long
    goal: Goal | None = None
    order: tuple[Any, Any] = (None, None)  # of the goal held and of the own one
    lives: int = 1
    since: float = 0.0
    sent: int = 0


class Invariants:
    """The judge of one history."""

    def __init__(self, swarm: VirtualSwarm) -> None:
        self._swarm = swarm
        self._robots: dict[str, _Memory] = {}
        self._issued = swarm.issued
        self._taken: dict[tuple[str, int, str], list[float]] = {}
        # By robot and origin, then by id: the life and s in which it was taken, and s of it.
        self._incidents: dict[tuple[str, str, str, bool], dict[str, tuple[int, float, float]]] = {}
        self._lies: set[str] = set()  # ids of incidents that have not happened
        self._wolves: set[str] = set()  # robots that told some
        self._latches: set[str] = set()  # all that were held
        self._deaths: dict[str, Death] = {}  # by robot, the last one
        self._died_at: dict[str, float] = {}
        # By robot, life and goal: the latest stop of all that each of its givers has obeyed.
        self._given: dict[tuple[str, int, str], float] = {}
        # By robot, instance and revision: the ids that peers gave, and when.
        self._silent: dict[tuple[str, str, int], list[tuple[str, float]]] = {}

    def forget(self, robot: str) -> None:
        """A robot has lost its disk."""
        self._robots.pop(robot, None)
        for key in [key for key in self._incidents if key[0] == robot]:
            del self._incidents[key]

    def forget_stops(self, robot: str) -> None:
        """A robot has ended before what it obeyed was on its disk."""
        if (known := self._robots.get(robot)) is not None:
            known.stopped = known.obeyed = known.stopped_all = known.reset = known.told = -1.0

    # Steps

    def on_event(self, daemon: VirtualDaemon) -> None:
        """Rules `stopped`, `old_goal`, `cause`, `latch`, `order` and `later_run`."""
        known = self._of(daemon)
        robot = daemon.robot
        self._check_order(daemon, known)
        held = frozenset(robot.latches)
        if held != known.held:
            self._check_latches(daemon, known, held)
        goal = None if robot.goal is None else robot.goal.goal
        if goal is not None and goal is not known.goal:
            self._check_goal(daemon, known.goal, goal)
            known.goal = goal
        is_running = robot.is_running
        if is_running and (not known.was_running or daemon.cause is not known.runs):
            self._check_begin(daemon, known)
            known.runs = daemon.cause
            known.began = self._swarm.now
        elif known.was_running and not is_running:
            self._check_end(daemon)
        if is_running:
            self._check_told(daemon, known)
        known.was_running, known.state = is_running, robot.state

    def on_twist(self, daemon: VirtualDaemon) -> None:
        """Rules `zero`, `still_pose`, `lost_base` and `lease`."""
        known = self._of(daemon)
        if not daemon.robot.is_running:
            raise BrokenRuleError(
                "zero", f"{daemon.name} is {daemon.robot.state} and moves its base"
            )
        if daemon.told_x is not None and daemon.told_way > STANDING_WAY:
            text = f"{daemon.name} drives {daemon.told_way:.2f} m by a pose that stands still"
            raise BrokenRuleError("still_pose", text)
        if not daemon.is_base_up:
            raise BrokenRuleError("lost_base", f"{daemon.name} commands motion to a lost base")
        if known.was_running and known.began < known.barred:
            ago = self._swarm.now - known.barred
            raise BrokenRuleError(
                "lost_base",
                f"{daemon.name} moves by a run of before the loss of its base {ago:.1f} s ago",
            )
        self.check_lease(daemon)

    def check_lease(self, daemon: VirtualDaemon) -> None:
        """The rule `lease`: who has renewed the run that moves a robot, and when."""
        goals = daemon.robot._lifecycle.goals  # its status costs more, and this is asked often
        own = goals.own
        if own is None or own.goal.lease is None or daemon.cause is None:
            return
        if goals.state is not GoalState.RUNNING:
            return  # a run without a goal moves it
        if daemon.cause.goal_id != own.goal.id:
            return
        renewed = self._swarm.renewed.get(own.goal.id, -math.inf)
        if isinstance(daemon.cause.request, RunRequest):  # the run itself counts as a renewal
            renewed = max(renewed, daemon.cause.at)
        late = self._swarm.now - renewed - own.goal.lease
        if late > LEASE_SHIFT + MOST_WAYS * self._swarm.slowest:
            raise BrokenRuleError(
                "lease",
                f"{daemon.name} moves by {own.goal.text}, whose lease ended {late:.1f} s ago",
            )

    def on_base(self, daemon: VirtualDaemon) -> None:
        """The rule `lost_base`: when the base was lost."""
        known = self._of(daemon)
        if not daemon.is_base_up:
            known.lost = self._swarm.now
        elif self._swarm.now - known.lost > LOSS_TIME:
            known.barred = known.lost

    def on_reply(self, daemon: VirtualDaemon, request: Request, reply: Reply) -> None:
        """Rules `stopped` and `answer`."""
        robot, known, now = daemon.robot, self._of(daemon), self._swarm.now
        if isinstance(request, StopRequest | EstopRequest):
            known.told = max(known.told, self._issued[request.id])
        if reply.code is not Code.APPLIED:
            self._check_refused(daemon, request)
            return
        if isinstance(request, StopRequest | EstopRequest):
            if robot.is_running or daemon.is_active:
                what = "runs" if robot.is_running else "loads a pattern"
                raise BrokenRuleError(
                    "stopped",
                    f"{daemon.name} answers `{request.verb}` {request.id} with `applied`"
                    f" ({reply.text}) and {what}",
                )
            issued = self._issued[request.id]
            cause = daemon.cause
            is_ended = known.was_running and isinstance(request, StopRequest)
            is_ended &= not self._is_of_two_machines(cause, request)
            late = 0.0 if cause is None else self._wanted(cause) - issued
            is_ended &= late > AGE_SHIFT + self._unseen_by(daemon, request.id)
            if is_ended and not self._is_logged(daemon, Reason.LOOP_STALLED):
                raise BrokenRuleError(
                    "cause",
                    f"the run of {daemon.name} is ended by a stop that was issued"
                    f" {late:.1f} s before it",
                )
            known.stopped = max(known.stopped, issued)
            known.obeyed = now
            if request.targets is None:
                known.stopped_all = max(known.stopped_all, issued)
        elif isinstance(request, RunRequest | ResumeRequest) and not robot.is_running:
            raise BrokenRuleError(
                "answer", f"{daemon.name} answers `{request.verb}` and does not run"
            )
        elif isinstance(request, ResetRequest):
            if known.state not in (State.IDLE, State.RUNNING):
                known.reset = now
            if robot.state in (State.ESTOPPED, State.FAULTED) or robot.latches:
                raise BrokenRuleError(
                    "answer", f"{daemon.name} answers `reset` and is {robot.state}"
                )
        elif isinstance(request, GoalRequest):
            held = robot.goal
            if held is None or held.goal.order < request.goal.order:
                raise BrokenRuleError(
                    "answer", f"{daemon.name} answers `goal` and does not hold it"
                )
        elif isinstance(request, LabelRequest) and robot.labels != (request.labels or ()):
            raise BrokenRuleError("answer", f"{daemon.name} answers `label` and has other labels")

    def on_send(self, daemon: VirtualDaemon, body: Datagram) -> None:
        """Rules `handed_on` and `storm`."""
        known = self._of(daemon)
        if self._swarm.now - known.since >= 1.0:
            known.since, known.sent = self._swarm.now, 0
        known.sent += 1
        if known.sent > MAX_SENT:
            kind = type(body).__name__
            raise BrokenRuleError("storm", f"{daemon.name} sends a storm, of {kind} and others")
        if not isinstance(body, Stop):
            return
        robot, name, issued = daemon.robot, daemon.name, self._issued[body.id]
        if self._swarm.now - issued > LIFETIME + LATE:
            raise BrokenRuleError(
                "handed_on", f"{name} hands on a {body.verb} of {body.age / 1e3:.0f} s"
            )
        if body.verb == "estop" and body.id in robot.cleared and body.id not in robot.latches:
            raise BrokenRuleError(
                "handed_on", f"{name} hands on the estop {body.id}, which was reset"
            )
        held = robot.goal
        if body.verb != "stop" or body.targets is not None or held is None:
            return
        is_run_of_all = held.goal.pattern and not held.goal.targets and held.issued is not None
        shift = AGE_SHIFT + self._unseen_age(body.hops - 1)
        if is_run_of_all and self._issued[held.goal.id] > issued + shift:
            raise BrokenRuleError(
                "handed_on", f"{name} hands on a stop of all, which is older than {held.goal.text}"
            )

    def on_program(self, daemon: VirtualDaemon, sender: str) -> None:
        """The rule `program`."""
        if sender in self._swarm.robots and daemon.knows(sender):
            raise BrokenRuleError(
                "program", f"{daemon.name} takes a message in the name of {sender}"
            )
        taken = self._taken.setdefault((daemon.name, daemon.lives, sender), [])
        taken.append(self._swarm.now)
        most = CHANNEL_BURST + CHANNEL_RATE
        recent = [at for at in taken if self._swarm.now - at < 1.0]
        if len(recent) > most:
            raise BrokenRuleError(
                "program", f"{daemon.name} takes {len(recent)} messages of {sender}"
            )

    def on_found(self, daemon: VirtualDaemon, found: FoundGoal, source: str) -> None:
        """The rule `old_goal`: what those that hand a goal on have obeyed, the least of them."""
        giver, given = self._robots.get(source), (daemon.name, daemon.lives, found.goal.id)
        stopped_all = -1.0 if giver is None else giver.stopped_all
        self._given[given] = min(stopped_all, self._given.get(given, math.inf))

    # Incidents

    def motion_of(self, daemon: VirtualDaemon) -> object:
        """What moves a robot."""
        robot = daemon.robot
        held = frozenset(robot.latches)
        return (
            robot.state, robot.epoch, held, robot.goal, robot.running_generation, daemon.twist
        )  # fmt: skip

    def check_motion(self, daemon: VirtualDaemon, before: object) -> None:
        """The rule `unmoved`."""
        if before != (after := self.motion_of(daemon)):
            raise BrokenRuleError(
                "unmoved", f"the black box of {daemon.name} changes {before} to {after}"
            )

    def on_incident(
        self, daemon: VirtualDaemon, incident: Incident, at: float, source: str
    ) -> None:
        """The rule `few`, in all lives that have the same disk."""
        now, name, life = self._swarm.now, daemon.name, daemon.lives
        is_silent = incident.kind == IncidentKind.SILENT and incident.by == name
        is_death = is_silent and incident.robot == name
        taken = self._incidents.setdefault((name, *_origin_of(incident), bool(source)), {})
        # A daemon knows of earlier lives when the incidents were, not when it heard of them. One
        # that was killed within a tick may take the same incident again.
        others = [times for id, times in taken.items() if id != incident.id]
        last = max(
            (heard if lived == life else began for lived, heard, began in others), default=-1
        )
        is_soon = not is_death and now - last < INCIDENT_GAP and last >= 0.0
        count = sum(now - began < 3600.0 for _, _, began in others)
        if is_soon or count >= INCIDENTS_AN_HOUR:
            raise BrokenRuleError(
                "few", f"{name} takes another incident of {incident.by} after {count}: {incident}"
            )
        taken[incident.id] = (life, at if is_death else now, at)
        if is_silent and not is_death:
            seen = daemon.peer.membership.lost_beacon(incident.robot)
            assert seen is not None
            key = incident.robot, seen.instance.hex(), seen.revision
            self._silent.setdefault(key, []).append((incident.id, now))

    def on_file(self, daemon: VirtualDaemon) -> None:
        """The rule `few`: files."""
        if (count := daemon.black_box.count()) > INCIDENT_FILES:
            raise BrokenRuleError("few", f"{daemon.name} keeps {count} files of incidents")

    def on_wolf(self, robot: str, ids: Iterable[str]) -> None:
        """A robot tells these incidents, none of which has happened."""
        self._wolves.add(robot)
        self._lies.update(ids)

    def on_displaced(
        self,
        daemon: VirtualDaemon,
        before: Sequence[KeptIncident],
        gone: Mapping[str, KeptIncident],
        new: IncidentHead,
    ) -> None:
        """The rule `fair`."""
        teller = (new.incident.by, bool(new.source))
        counts = Counter((one.incident.by, bool(one.source)) for one in before if not one.operator)
        for id, one in gone.items():
            loser = (one.incident.by, bool(one.source))
            if one.operator and not new.operator:
                text = f"{new.incident} displaces the mark {id} of {one.operator}"
                raise BrokenRuleError("fair", f"on {daemon.name} {text}")
            is_lie = new.incident.id in self._lies
            if is_lie and loser != teller and counts[loser] <= counts[teller]:
                text = f"the lie {new.incident} of {teller} displaces {one.incident}"
                raise BrokenRuleError("fair", f"on {daemon.name} {text}")

    def on_death(self, daemon: VirtualDaemon, death: Death | None) -> None:
        """The rule `death`, of the death before the one that is noted now."""
        self._check_death(daemon)
        self._deaths.pop(daemon.name, None)
        if death is None:
            return
        before, self._died_at[daemon.name] = self._died_at.get(daemon.name, -math.inf), death.at
        # One of less than 10 s after another one begins none; the ring ends a tick before a death.
        is_counted = death.last - before > INCIDENT_GAP + RING_LAG
        if is_counted and self._swarm.now - daemon.black_box.began > 1.0:
            self._deaths[daemon.name] = death

    def _check_death(self, daemon: VirtualDaemon) -> None:
        name, box, death = daemon.name, daemon.black_box, self._deaths.get(daemon.name)
        if death is None or box.was_frozen or self._swarm.now < box.writes_at:
            return
        if self._count_taken(name, name, "death") >= INCIDENTS_AN_HOUR:
            return
        found = [
            id
            for id, head in box.heads().items()
            if head.incident.kind == IncidentKind.SILENT
            and head.incident.robot == name
            and head.at <= death.at
            and death.last - 1.0 <= head.end
        ]
        if not found:
            raise BrokenRuleError("death", f"{name} has no incident of {death}")
        given = self._silent.get((name, death.instance, death.revision), ())
        if not all(id in death.known for id, at in given if at < death.last):
            return  # it does not know of an earlier silence
        for id, at in given:
            if at >= death.last and id not in (*found, *death.known):
                raise BrokenRuleError("death", f"{name} keeps {death} as {found}, a peer as {id}")

    def _count_taken(self, name: str, by: str, among: str) -> int:
        """How many incidents of one robot a robot has taken, from whichever peer."""
        keys = [key for key in self._incidents if key[:3] == (name, by, among)]
        return sum(len(self._incidents[key]) for key in keys)

    def unheard(self) -> list[tuple[VirtualDaemon, Incident]]:
        """The incidents that robots tell and others do not keep, which were up then."""
        now = self._swarm.now
        alive = [one for one in self._swarm.robots.values() if one.is_up]
        told = [both for one in alive for both in one.black_box.service.told]
        return [
            (one, incident)
            for one in alive
            if one.name not in self._wolves
            for incident, at in told
            if max(now - WINDOW, one.black_box.began + 1.0) < at
            and not one.black_box.has_file(incident.id)
            and incident.id not in self._lies
            and incident.by not in self._wolves
            and self._count_taken(one.name, *_origin_of(incident)) < INCIDENTS_AN_HOUR
        ]

    def check_incidents(self, unheard: list[tuple[VirtualDaemon, Incident]]) -> None:
        """Rules `heard` and `death`; `unheard`: TELL_TIME ago, when all was healed."""
        estops = set()
        for one in self._swarm.robots.values():
            self._check_death(one)
            heads = one.black_box.heads().items()
            estops |= {id for id, head in heads if head.incident.kind == IncidentKind.ESTOP}
        estops -= self._lies
        for one, incident in unheard:
            if not one.black_box.has_file(incident.id):
                raise BrokenRuleError("heard", f"{one.name} does not keep {incident}")
        if len(estops) > len(self._latches):
            raise BrokenRuleError(
                "heard", f"{len(self._latches)} emergency stops have {len(estops)} ids"
            )

    # Rules

    def _check_begin(self, daemon: VirtualDaemon, known: _Memory) -> None:
        cause, name = daemon.cause, daemon.name
        assert cause is not None
        if known.held:
            raise BrokenRuleError("stopped", f"{name} runs with the latches {sorted(known.held)}")
        if cause.request is not None:
            asked = self._issued.get(cause.request.id)
            if cause.at < known.obeyed or (asked is not None and asked < known.stopped):
                raise BrokenRuleError(
                    "stopped",
                    f"{name} runs by `{cause.request.verb}` of before the stop that it obeyed",
                )
            late = 0.0 if asked is None else cause.at - asked
            late -= self._swarm.worked.get(cause.request.id, 0.0)
            if late > MAX_START_AGE + AGE_SHIFT + self._unseen_by(daemon, cause.request.id):
                raise BrokenRuleError(
                    "late_start",
                    f"{name} runs by `{cause.request.verb}` of {late:.1f} s ago, beside its work",
                )
            known.stopped = known.reset = -1.0  # an operator wants it to run again
            own = daemon.robot.goals.own
            known.resumed = ("", -1.0) if own is None or asked is None else (own.id, asked)
            return
        goal = daemon.robot.goals.own
        assert goal is not None, "a robot joins by a goal"
        issued = self._issued[goal.id]
        age = cause.at - issued
        limit = min(goal.valid or 0.0, goal.seconds or 1e9)
        if goal.on_join != "run" or age > limit + AGE_SHIFT:
            raise BrokenRuleError(
                "old_goal", f"{name} joins {goal.text}, {age:.1f} s old, valid for {goal.valid} s"
            )
        for what, at in (("stop", known.stopped), ("reset", known.reset)):
            if issued < at - AGE_SHIFT:
                raise BrokenRuleError(
                    "old_goal",
                    f"{name} joins {goal.text}, which is {at - issued:.1f} s older than the"
                    f" {what} that it obeyed",
                )
        stopped_all = self._given.get((name, daemon.lives, goal.id), -1.0)
        if issued < stopped_all - AGE_SHIFT:
            raise BrokenRuleError(
                "old_goal",
                f"{name} joins {goal.text}, which is {stopped_all - issued:.1f} s older than"
                " the stop of all that its giver obeyed",
            )

    def _check_told(self, daemon: VirtualDaemon, known: _Memory) -> None:
        cause = daemon.cause
        assert cause is not None
        goal, resumed = known.resumed
        is_resumed = cause.request is None and cause.goal_id == goal
        early = known.told - max(self._wanted(cause), resumed if is_resumed else -1.0)
        if early > ROUNDING:
            what = "joined goal" if cause.request is None else f"`{cause.request.verb}`"
            raise BrokenRuleError(
                "later_run",
                f"{daemon.name} runs by a {what} that was typed {early:.2f} s before a stop that"
                " it knows",
            )

    def _check_refused(self, daemon: VirtualDaemon, request: Request) -> None:
        cause = daemon.cause
        if not isinstance(request, StopRequest) or not daemon.robot.is_running or cause is None:
            return
        late = self._issued[request.id] - self._wanted(cause)
        if late > AGE_SHIFT:
            raise BrokenRuleError(
                "stopped",
                f"{daemon.name} refuses the stop {request.id}, which is {late:.1f} s later than"
                " its run, and goes on",
            )

    def _is_of_two_machines(self, cause: Cause | None, stop: StopRequest | EstopRequest) -> bool:
        """True if run and stop have one clock id and are of different clocks: in doubt it stops."""
        run = None if cause is None else cause.request
        if run is None or not stop.clock or run.clock != stop.clock:
            return False
        shifts = [one.issued - self._issued[one.id] for one in (run, stop)]
        return abs(shifts[0] - shifts[1]) > ROUNDING

    def _wanted(self, cause: Cause) -> float:
        """When an operator asked for a run: of a robot that joins, when the goal was set."""
        return self._issued[cause.goal_id if cause.request is None else cause.request.id]

    def _unseen_by(self, daemon: VirtualDaemon, id: str) -> float:
        """The longest time, in s, by which a stop may be older than its robot can tell."""
        return self._unseen_age(daemon.hops.get(id, 0)) + daemon.waits.get(id, 0.0)

    def _unseen_age(self, hops: int) -> float:
        """The longest time in s by which a stop that `hops` robots handed on seems too late.

        The time counts from a request, which may seem too early by one way.
        """
        return (hops + 2) * self._swarm.most_delay * self._swarm.slowest

    def _check_order(self, daemon: VirtualDaemon, known: _Memory) -> None:
        robot = daemon.robot
        order = tuple(one and one.order for one in (robot.goal, robot.goals.own))
        for before, now in zip(known.order, order, strict=True):
            if before is not None and (now is None or now < before):
                raise BrokenRuleError(
                    "order", f"{daemon.name} goes back from goal {before} to {now}"
                )
        known.order = order[0], order[1]

    def _check_end(self, daemon: VirtualDaemon) -> None:
        reason = daemon.robot.status(self._swarm.now).reason
        if reason is None:
            raise BrokenRuleError("cause", f"the run of {daemon.name} ends without a reason")
        if not self._is_logged(daemon, *Reason):
            raise BrokenRuleError("cause", f"no line tells why {daemon.name} ends: {reason}")

    def _is_logged(self, daemon: VirtualDaemon, *reasons: Reason) -> bool:
        """True if the robot has recorded an event with one of these reasons just now."""
        status = daemon.robot.status(self._swarm.now)
        new = [one.text for one in status.events if one.at >= status.uptime - 1e-6]
        return any(f"({reason})" in text for text in new for reason in reasons)

    def _check_goal(self, daemon: VirtualDaemon, before: Goal | None, goal: Goal) -> None:
        """A goal that a stop makes follows the goal that was held; that must be older."""
        found = daemon.event
        is_found = isinstance(found, FoundGoal) and found.goal.id == goal.id
        if before is None or goal.pattern is not None or is_found:
            return
        late = self._issued[before.id] - self._issued[goal.id]
        shift = AGE_SHIFT + self._unseen_by(daemon, goal.id)
        if late > shift and not isinstance(found, GoalRequest):
            raise BrokenRuleError(
                "cause",
                f"{daemon.name} makes {goal.text} of a stop that was issued {late:.1f} s"
                f" before {before.text}",
            )

    def _check_latches(self, daemon: VirtualDaemon, known: _Memory, held: frozenset[str]) -> None:
        lost, new = known.held - held, held - known.held
        cleared = set(daemon.robot.cleared)
        if not lost <= cleared:
            raise BrokenRuleError(
                "latch", f"{daemon.name} lost the latches {sorted(lost - cleared)}"
            )
        request = daemon.event
        is_direct = isinstance(request, EstopRequest) and not request.is_relayed
        back = new & known.cleared
        if back and not is_direct:
            raise BrokenRuleError(
                "latch", f"{daemon.name} holds {sorted(back)} again, which were reset"
            )
        self._latches |= held
        for id in new:
            issued = self._issued.get(id, self._swarm.now)
            known.stopped = max(known.stopped, issued)
            known.told = max(known.told, issued)
            if daemon.robot.latches[id].scope == "swarm":
                known.stopped_all = max(known.stopped_all, issued)
        known.held, known.cleared = held, cleared

    def check_healed(self) -> None:
        """The rule `agreement`, ten seconds after all is healed."""
        alive = [one for one in self._swarm.robots.values() if one.is_up]
        goals = {one.name: one.robot.goal for one in alive}
        contents = {name: None if held is None else held.content for name, held in goals.items()}
        if len(set(contents.values())) > 1:
            texts = {n: "none" if g is None else g.goal.text for n, g in goals.items()}
            raise BrokenRuleError("agreement", f"the robots hold different goals: {texts}")
        for one in alive:
            self._check_state(one)
        self._check_spread(alive)

    def _check_state(self, one: VirtualDaemon) -> None:
        robot, name = one.robot, one.name
        if (robot.state is State.ESTOPPED) != bool(robot.latches):
            raise BrokenRuleError(
                "agreement", f"{name} is {robot.state} with {len(robot.latches)} latches"
            )
        if not one.is_settled:
            raise BrokenRuleError("agreement", f"{name} is not ready")
        if not robot.is_running:
            return
        status = robot.status(self._swarm.now).goal
        cause, own = one.cause, None if status is None else status.own
        if own is None or cause is None or status is None or not cause.goal_id:
            return
        if cause.goal_id != own.goal.id or status.state is not GoalState.RUNNING:
            raise BrokenRuleError(
                "agreement", f"{name} runs {cause.goal_id}, and its goal is {own.goal.text}"
            )

    def _check_spread(self, alive: list[VirtualDaemon]) -> None:
        for one in alive:
            for id, latch in one.robot.latches.items():
                if latch.scope != "swarm":
                    continue
                for other in alive:
                    if id not in other.robot.latches and id not in other.robot.cleared:
                        raise BrokenRuleError(
                            "latch", f"{other.name} lacks the latch {id} of {one.name}"
                        )

    def _of(self, daemon: VirtualDaemon) -> _Memory:
        known = self._robots.get(daemon.name)
        if known is None:
            known = self._robots[daemon.name] = _Memory(held=frozenset(daemon.robot.latches))
            known.cleared = set(daemon.robot.cleared)
        if known.lives != daemon.lives:
            known.lives = daemon.lives
            known.was_running, known.runs, known.goal = False, None, None
            known.order = (None, None)
        return known


def _origin_of(incident: Incident) -> tuple[str, str]:
    """The robot that begins it, and what it counts among."""
    if incident.kind == IncidentKind.MARK:
        return incident.by, "mark"
    if incident.robot != incident.by:
        return incident.by, "peers"
    return incident.by, "death" if incident.kind == IncidentKind.SILENT else ""


class _Errors(logging.Handler):
    """Keeps the error that a log has a traceback of."""

    error: BaseException | None = None

    def emit(self, record: logging.LogRecord) -> None:
        if record.exc_info and record.levelno >= logging.ERROR:
            self.error = self.error or record.exc_info[1]


@contextmanager
def no_exception() -> Iterator[None]:
    """Judge the rule `exception` in this block."""
    errors, logger = _Errors(), logging.getLogger("swarmd")
    logger.addHandler(errors)
    try:
        yield
        if errors.error is not None:
            raise errors.error
    except BrokenRuleError:
        raise
    except (Exception, CoreFault) as error:
        cause = error.__cause__ if isinstance(error, CoreFault) else error
        if isinstance(cause, BrokenRuleError):  # within a request
            raise cause from None
        text = "".join(traceback.format_exception(cause or error))
        raise BrokenRuleError("exception", text) from error
    finally:
        logger.removeHandler(errors)


@dataclass(frozen=True)
class Rule:
    """A row of `RULES`. `sentence`: for people, in docs/evidence/motion.md.

    `functions`: those that judge histories; empty: only sequences (`tests/sequences`) are judged.
    `histories`: how many random histories were judged, for the page.
    """

    name: str
    sentence: str
    functions: tuple[Callable[..., object], ...] = ()
    histories: int = HISTORIES


_ROWS = (
    Rule(
        "stopped",
        "A robot that acknowledged a stop stands until a request that was typed later.",
        (Invariants.on_reply, Invariants._check_begin, Invariants._check_refused),
    ),
    Rule(
        "later_run",
        "A robot that knows of a stop, also by others, does not go on with a run whose request was"
        " typed before that stop, unless a later `resume` let it go on.",
        (Invariants._check_told,),
    ),
    Rule(
        "late",
        "Nothing late starts motion: no copy of a request, no older request, no late report of the"
        " pattern host.",
    ),
    Rule(
        "late_start",
        "No run starts by a request that is older than 5 s, beside the time for which its sender"
        " worked and the wait for its start time.",
        (Invariants._check_begin,),
    ),
    Rule(
        "zero",
        "Outside the state `running` a robot commands zero.",
        (Invariants.on_twist,),
    ),
    Rule(
        "answer",
        "An answer counts only what is known: success means that it has happened, and rest that the"
        " base was measured at rest.",
        (Invariants.on_reply,),
    ),
    Rule(
        "latch",
        "An emergency stop is held until a reset that names it, and by nothing else it ends; what"
        " was reset does not come back by others.",
        (Invariants._check_latches, Invariants._check_spread),
    ),
    Rule(
        "lost_base",
        "A base or link that comes back moves nothing by itself.",
        (Invariants.on_twist,),
    ),
    Rule(
        "hold",
        "While there is a reason to stand a robot commands zero; a run that stood for 2 s is over,"
        " and so is one that a lift or a low battery ended.",
    ),
    Rule(
        "old_goal",
        "No robot joins a goal that is too old, or older than a stop or reset that it has obeyed.",
        (Invariants._check_begin, Invariants.on_found),
    ),
    Rule(
        "cause",
        "No run ends without a cause that the robot names.",
        (Invariants._check_end, Invariants._check_goal, Invariants.on_reply),
    ),
    Rule(
        "hand",
        "A robot drives by hand only by a word of who has it in hand, in time and after each stop;"
        " its run waits, also beneath a hand that was lost.",
    ),
    Rule(
        "exception",
        "No code of a robot, a peer or an operator raises an exception, or logs one as an error.",
        (no_exception,),
    ),
    Rule(
        "agreement",
        "Ten seconds after all is healed the robots agree.",
        (Invariants.check_healed,),
    ),
    Rule(
        "handed_on",
        "What is over is not handed on.",
        (Invariants.on_send,),
    ),
    Rule(
        "storm",
        "A robot sends at most 300 datagrams within a second.",
        (Invariants.on_send,),
    ),
    Rule(
        "order",
        "The goal of a robot never goes back to an earlier one.",
        (Invariants._check_order,),
    ),
    Rule(
        "program",
        "No robot takes a message of a program as one of a robot, or more than the limits allow.",
        (Invariants.on_program,),
    ),
    Rule(
        "still_pose",
        "A pose that stands still moves no fenced robot farther than 25 cm in one life of its"
        " daemon.",
        (Invariants.on_twist,),
    ),
    Rule(
        "lease",
        "No run goes on for longer than its lease after its operator has ended, also if an attacker"
        " replays leases in a secured swarm.",
        (Invariants.on_twist, Invariants.check_lease),
        histories=LEASE_HISTORIES,
    ),
    Rule(
        "unmoved",
        "An incident, marked or told by a peer, changes no state, command or goal of a robot.",
        (Invariants.check_motion,),
    ),
    Rule(
        "heard",
        "Within 50 s after all is healed each robot that was up keeps what others tell of the 50 s"
        " before, under one id; an emergency stop has one id on all robots.",
        (Invariants.check_incidents,),
    ),
    Rule(
        "few",
        "A robot takes at most one incident of an origin in 10 s and six an hour, of itself, its"
        " deaths, lost peers and marks, and keeps at most 20 files.",
        (Invariants.on_incident, Invariants.on_file),
    ),
    Rule(
        "fair",
        "A robot that tells incidents which never happened displaces no mark of an operator, and"
        " nothing of a robot that has fewer.",
        (Invariants.on_displaced,),
    ),
    Rule(
        "death",
        "A robot whose daemon was killed keeps an incident of that after its restart, under the id"
        " that its peers gave it.",
        (Invariants._check_death,),
    ),
)
RULES: Mapping[str, Rule] = {rule.name: rule for rule in _ROWS}
