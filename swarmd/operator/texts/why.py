"""Why a robot does not move, in one sentence with what to do."""

from __future__ import annotations

import math
from collections.abc import Collection, Iterable, Iterator
from itertools import islice

from swarmd.core import codec
from swarmd.core.messages import (
    DecisionSummary,
    Latch,
    LimitingObstacle,
    Presence,
    Reason,
    State,
    Status,
)
from swarmd.core.verbs import shortened
from swarmd.operator.session.members_view import Contact, SeenMember
from swarmd.operator.texts.shown_fields import shown_lines
from swarmd.operator.texts.values import NOTHING, centimetres, printable, seconds

_SAME_OBSTACLE = math.radians(10.0)
MAX_STOPS = 3
"""Emergency stops that a sentence or a list of problems tells; `describe` tells all."""
_MAX_REASON = 256  # characters of the reason of an emergency stop, as operators may send
_START = "start it with `swarmctl run PATTERN {robot}`"

DRIVEN = "driven"
"""The word of all displays for the state of a robot that an operator drives by hand."""
SILENT = "silent"
"""The word of all displays for the state of a robot that is not heard."""

HOLDS = {
    Reason.NO_SCAN: ("no scan arrives{detail}; check the driver{driver}", "no scan arrived"),
    Reason.INVALID_SCAN: (
        "too many rays are missing in its scans{detail}; check the lidar",
        "too many rays were missing in its scans",
    ),
    Reason.STALE_SCAN: (
        "its last scan is too old{age}; check the lidar and the driver{driver}",
        "scans stopped arriving",
    ),
    Reason.FROZEN_SCAN: ("its scans repeat{detail}; check the lidar", "its scans repeated"),
    Reason.FROZEN_STAMP: (
        "its scans come with a stamp that stands still{detail}; check the clock"
        " and the driver that stamp them{driver}",
        "the stamps of its scans stood still",
    ),
    Reason.CLOCK_SET: (
        "the clock that stamps its scans or odometry was set{detail}{driver}; let the"
        " clocks of its computers agree before a run, or start again what stamps them",
        "the clock that stamps its scans or odometry was set",
    ),
    Reason.SCAN_CONFLICT: (
        "more than one node publishes its scan{detail}{driver}; end all but one",
        "more than one node published its scan",
    ),
    Reason.BASE_CONFLICT: (
        "its driver reaches more than one base{detail}{driver}; end all but one",
        "its driver reached more than one base",
    ),
    Reason.HAZARD: (
        "a hazard of its base{detail}; look at the robot",
        "its base reported a hazard, or its hazards were not heard",
    ),
    Reason.LATE_SCAN: (
        "its scans arrive {late} later than the platform's scan.latency; shorten the"
        " way of the scans, or correct the platform: `swarmctl calibrate {robot}` measures it",
        "its scans arrived too late",
    ),
    Reason.STALE_ODOMETRY: (
        "its odometry is too old, or its stamp stands still{detail}; check the driver{driver}",
        "odometry stopped arriving, or its stamp stood still",
    ),
    Reason.COMMAND_EXPIRED: (
        "the pattern sends no commands{detail}; its host is restarted soon",
        "the pattern stopped sending commands",
    ),
    Reason.DRIVER_LOST: (
        "its base does not answer{driver}; check the driver",
        "its base did not answer",
    ),
    Reason.INCOMPATIBLE_PEER: (
        "{peer}{detail}",
        "it did not see a peer, or a peer was faster than it assumes",
    ),
    Reason.NO_POSE: (
        "it has a fence and no usable pose{detail}; check the localisation{driver}",
        "it has a fence and had no usable pose",
    ),
    Reason.HAND_LOST: (
        "who drove it was not heard{detail}; `swarmctl resume {robot}` lets its run go on",
        "who drove it was not heard",
    ),
    Reason.PATTERN_RESTARTING: (
        "the pattern failed and is being loaded again{detail}",
        "the pattern failed and could not be loaded again",
    ),
}
"""Of each hold: its sentence while it is present, and why it has ended a run (it may be over)."""

SENTENCES = {
    Reason.NEVER_ASKED: f"has not been run yet; {_START}",
    Reason.FINISHED: f"the pattern has finished{{detail}}; {_START}",
    Reason.RESET: f"was reset{{detail}}; {_START}",
    Reason.OPERATOR: f"an operator stopped it{{detail}}; {_START}",
    Reason.RELOADED: f"the code of its pattern was replaced{{detail}}; {_START}",
    Reason.ESTOP: "emergency stop{stops}; clear it with `swarmctl reset {robot}`",
    Reason.LOOP_STALLED: "its daemon was blocked for over 1 s{detail}; check its host, then run",
    Reason.LOAD_FAILED: "the pattern could not be loaded{detail}; correct it, then run",
    Reason.DUPLICATE_ID: "another daemon has the same id{detail}; stop one of them, then reset",
    Reason.QUARANTINED: "the pattern failed{detail}; correct it, then reset",
    Reason.LEAVING: "its daemon is shutting down",
    Reason.NETWORK_CHANGED: f"its network has changed{{detail}}; {_START}",
    Reason.ROSTER_CHANGED: f"it has taken another roster{{detail}}; {_START}",
    Reason.SUPERSEDED: "a later goal ended its run{detail}; see `swarmctl goal`",
    Reason.LEASE_ENDED: f"the operator of its run was not heard{{detail}}; {_START}",
    Reason.LOW_BATTERY: f"its battery is low{{detail}}; charge it, then {_START}",
    **{reason: present for reason, (present, _) in HOLDS.items()},
    Reason.NO_REQUESTED_COMMAND: "the pattern requests no motion",
    Reason.PROTECTION: "protection holds it{gap}{remedy}",
}
"""Sentence of each reason, with the fields that `why` fills in."""


def standing_of(state: str, reason: str) -> str:
    """Why a running robot stands: `at rest` if its pattern wants so, else `held`.

    Empty for a robot that moves, or that does not run.
    """
    if state != State.RUNNING or not reason:
        return ""
    return "at rest" if reason == Reason.NO_REQUESTED_COMMAND else "held"


def state_word(status: Status) -> str:
    """The state of a robot in the word of all displays; of a running robot that stands, why.

    A robot in the hand of an operator is `driven`, whatever waits beneath.
    """
    if status.driven_by:
        return DRIVEN
    return standing_of(status.state, status.reason or "") or status.state.value


def why(member: SeenMember) -> str:
    """One sentence: the state of a robot; if the robot stands, the reason and what to do."""
    status = member.status
    if member.contact is Contact.UNREACHABLE:  # only the peer `member.by` hears the robot
        return f"alive by {member.by}'s word, {seconds(member.age)} ago; not reachable from here"
    if member.contact is Contact.OTHER_VERSION:
        return f"{member.state}; it speaks {member.wire}, this swarmctl {codec.VERSION}"
    if member.presence is not Presence.ALIVE:
        forget = f"`swarmctl members forget {member.robot}` removes it from the list"
        return f"{member.presence} {seconds(member.age)} ago; {forget}"
    if status is None:
        heard = f"heard {seconds(member.age)} ago"
        return f"{heard}, {member.state or 'alive'}, but it sent no status; try again"
    if status.driven_by:
        return _text_if_driven(status)
    if status.reason is None:
        return _text_if_moving(status)
    if status.state is State.RUNNING:
        return f"running {status.pattern}, not moving: {_text_if_standing(member.robot, status)}"
    if status.reason in HOLDS:
        # The hold lasted, so the run ended. In the past tense, since the hold may be over.
        start = _START.format(robot=member.robot)
        past_hold = f"{HOLDS[status.reason][1]}{_detail(status)}; when that is solved, {start}"
        return f"{status.state}: {past_hold}{_lost(status)}"
    return f"{status.state}: {_text_if_standing(member.robot, status)}{_lost(status)}"


def _text_if_driven(status: Status) -> str:
    """The sentence for a robot that an operator drives by hand."""
    waits = f", {status.pattern} waits" if status.state is State.RUNNING else ""
    text = f"driven by {status.driven_by}{waits}"
    if status.reason is None:
        return f"{text}; moving{_limit(status.decision)}"
    if status.reason is Reason.NO_REQUESTED_COMMAND:
        return f"{text}; at rest, as the hand asks"
    return f"{text}; not moving: {_text_if_standing(status.robot, status)}"


def _text_if_moving(status: Status) -> str:
    """The sentence for a robot that has no reason to stand."""
    manoeuvre = " around an obstacle" if status.decision.is_recovering else ""
    if status.decision.avoiding:
        manoeuvre = f", {status.decision.avoiding}"
    pattern = status.pattern or "no pattern"
    return f"{status.state} {pattern}, moving{manoeuvre}{_limit(status.decision)}"


def _text_if_standing(robot: str, status: Status) -> str:
    """Why a robot stands: the sentence of its reason, in which its fields are filled in."""
    reason = status.reason
    assert reason is not None
    if reason is Reason.PROTECTION and status.decision.avoiding:
        return f"{status.decision.avoiding}{_limit(status.decision)}"
    age = status.decision.scan_age
    return SENTENCES[reason].format(
        robot=robot,
        detail=_detail(status),
        stops=stops_text(status.latches.values()),
        age=f" ({seconds(age)})" if age is not None else "",
        # By how much scans are later than the platform declares.
        late=NOTHING if status.scan_delay is None else seconds(status.scan_delay.added),
        driver=f" ({status.health.driver})" if status.health.driver else "",
        gap=_gap(status.decision),
        remedy=_remedy(status),
        peer=_peer(status),
    )


def stop_text(latch: Latch) -> str:
    """Who issued an emergency stop, when and why: `by bob@desk, 12.0 s ago, for swarm: smoke`.

    Operators and robots wrote the texts: a long reason is cut, and control characters become `?`.
    """
    when = "at an unknown time" if latch.age is None else f"{seconds(latch.age)} ago"
    facts = (f", {title} {text}" for title, text in shown_lines(latch, "Emergency stops", {}))
    reason = f": {shortened(latch.reason, _MAX_REASON)}" if latch.reason else ", without a reason"
    return printable(f"by {latch.issuer}, {when}{''.join(facts)}{reason}")


def stops_text(latches: Collection[Latch]) -> str:
    """The `stop_text` of each of the oldest MAX_STOPS, after a blank; empty without any."""
    texts = [stop_text(latch) for latch in islice(latches, MAX_STOPS)]
    if len(latches) > MAX_STOPS:
        texts.append(f"and {len(latches) - MAX_STOPS} more")
    return f" {'; '.join(texts)}" if texts else ""


def standing_time(status: Status) -> float | None:
    """For how many s the robot has its state; under emergency stops since the first was issued.

    None if the time of an emergency stop is not known: a restart began the state anew.
    """
    ages = [latch.age for latch in status.latches.values()]
    return max((age for age in ages if age is not None), default=None) if ages else status.since


def _detail(status: Status) -> str:
    return f" ({status.detail})" if status.detail else ""


def absence(member: SeenMember | None, *, has_age: bool = True) -> str:
    """The text for a robot without a present status, in a few words."""
    if member is None:
        return "not seen by any robot"
    if member.contact is Contact.OTHER_VERSION:
        return f"{member.state or 'alive'}, of another version: {member.version or '?'}"
    by = f" by {member.by}'s word" if member.by else ""
    age = f"{seconds(member.age)} ago" if has_age else ""
    parts = [f"heard {age}".rstrip(), "no answer"]
    if member.presence is not Presence.ALIVE:
        parts = [f"{member.presence}{by}", age]
    elif member.contact is Contact.UNREACHABLE:
        parts = [f"alive{by}", age, "not reachable from here"]
    return ", ".join(filter(None, parts))


def obstacles(rows: Iterable[LimitingObstacle]) -> Iterator[tuple[str, LimitingObstacle]]:
    """The limiting obstacles: a text such as `an obstacle at -30 deg, 0.21 m`, and a row for each.

    `rows`: obstacle points that constrain the command, the tightest first. The row of an obstacle
    is its tightest row. Further rows within 10 deg of this row belong to the same obstacle.
    """
    seen: list[LimitingObstacle] = []
    for row in rows:
        if all(
            math.cos(row.bearing - earlier.bearing) <= math.cos(_SAME_OBSTACLE) for earlier in seen
        ):
            seen.append(row)
            degrees = round(math.degrees(row.bearing))  # an int: no -0
            yield f"an obstacle at {degrees} deg, {max(row.gap, 0.0):.2f} m", row


def activity(decision: DecisionSummary) -> str:
    """The `protection_word`, with the share of the speed if that share is below 1.

    For example `active, speed 60%`.
    """
    word = protection_word_of(decision)
    return word if decision.speed_share == 1.0 else f"{word}, speed {decision.speed_share:.0%}"


def protection_word_of(decision: DecisionSummary) -> str:
    """The `protection_word` of a decision."""
    return protection_word(
        is_active=decision.is_active,
        is_recovering=decision.is_recovering,
        avoiding=decision.avoiding,
    )


def protection_word(*, is_active: bool, is_recovering: bool, avoiding: str = "") -> str:
    """One word on protection: `clear`, `active`, `recovering`, or the avoidance's text.

    That text is for example `avoiding tb3-04`.
    """
    if is_recovering:
        return "recovering"
    return avoiding or ("active" if is_active else "clear")


def lost_base(status: Status) -> str:
    """Why the robot's base is lost now; empty if it is not. Other nodes may move a lost base."""
    return "" if status.health.driver_up else status.health.driver


def _lost(status: Status) -> str:
    lost = lost_base(status)
    return f"; driver lost: {lost}" if lost else ""


def _peer(status: Status) -> str:
    """The first peer that holds the robot, and why."""
    held = (f"peer {peer.robot}: {peer.text}" for peer in status.peers if peer.holds)
    return next(held, "a peer is not seen, or is faster than assumed")


def _limit(decision: DecisionSummary) -> str:
    return next((f", limited by {text}" for text, _ in obstacles(decision.rows)), "")


def _gap(decision: DecisionSummary) -> str:
    if decision.rows:
        return _limit(decision)
    gap = decision.min_gap
    return f": the nearest obstacle is {gap:.2f} m away" if gap is not None else ""


def _remedy(status: Status) -> str:
    """Why a robot stands for long with free floor, and what to do; empty while it does not."""
    if status.held_for is None:
        return ""
    text = f"; so for {seconds(status.held_for)}, with free floor"
    wanted = status.set_down
    if wanted is None:
        return f"{text}: move it away from the obstacle"
    if wanted.unseen > 0.0:
        text += f", since up to {centimetres(wanted.unseen)} of an obstacle may be unseen"
    text += f": set it down {centimetres(wanted.gap)} from walls"
    if wanted.lidar is not None:  # this circle stays free of walls that stand, too
        text += f" ({wanted.lidar:.2f} m from its lidar)"
    elif status.walls_stand is None:
        text += ", or declare `walls_stand` where no wall moves"
    return text
