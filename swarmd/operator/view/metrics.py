"""The figures of a swarm in the text exposition format 0.0.4, which Prometheus and others scrape.

Pure: looks and statuses in, text out. The rules:

1. A name ends in its unit (`_seconds`, `_ratio`, `_bytes`, `_meters`, `_hertz`) or, for what only
   rises, in `_total`. A ratio is from 0 to 1, or more for `cpu` of several cores.
2. A figure that is not known is left out, never 0. Figures of a status are left out once the
   status is older than STATUS_SILENCE, those of a look once the look is older than LOOK_SILENCE.
3. The ages of status and look are told as figures of their own, from the first on.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from typing import Final

from swarmd.core.messages import STATUS_SILENCE, Presence, Reason, State, Status
from swarmd.operator.session.members_view import MembersView
from swarmd.operator.texts.why import standing_of

CONTENT_TYPE = "text/plain; version=0.0.4; charset=utf-8"
LOOK_SILENCE = 10.0  # s; the watch looks each second
NEVER_HEARD = "expected"
"""The presence of a robot of the roster that was never heard."""
_PRESENCES = (*(presence.value for presence in Presence), NEVER_HEARD)
_ESCAPES: Final = str.maketrans({"\\": "\\\\", '"': '\\"', "\n": "\\n"})
_GAUGE = "gauge"
_COUNTER = "counter"

_FAMILIES: Mapping[str, tuple[str, str]] = {
    "swarmd_info": (_GAUGE, "Always 1: the swarm, and the version of this page."),
    "swarmd_look_age_seconds": (_GAUGE, "Since this page last looked for members."),
    "swarmd_robots": (_GAUGE, "Robots by presence, by the last look."),
    "swarmd_robot_up": (_GAUGE, "1 for a robot that is heard, 0 for one that is not."),
    "swarmd_robot_presence": (_GAUGE, "1 for the presence of the robot, 0 for the others."),
    "swarmd_robot_status_age_seconds": (_GAUGE, "Since the robot told the figures below."),
    "swarmd_robot_info": (_GAUGE, "Always 1: the platform and the version of the robot."),
    "swarmd_robot_state": (_GAUGE, "1 for the state of the robot, 0 for the others."),
    "swarmd_robot_pattern_info": (_GAUGE, "Always 1: the pattern of the present run."),
    "swarmd_robot_held": (_GAUGE, "1 for a robot that runs and may not move, 0 for another."),
    "swarmd_robot_reason_info": (_GAUGE, "Always 1: why the robot does not move."),
    "swarmd_robot_estops": (_GAUGE, "Emergency stops that hold the robot."),
    "swarmd_robot_driver_up": (_GAUGE, "1 for a base that takes commands, 0 for a lost one."),
    "swarmd_robot_battery_ratio": (_GAUGE, "The charge of the battery."),
    "swarmd_robot_obstacle_meters": (_GAUGE, "From the footprint to the nearest obstacle."),
    "swarmd_robot_protection_active": (_GAUGE, "1 while protection changes the command."),
    "swarmd_robot_scan_rate_hertz": (_GAUGE, "Scans per second."),
    "swarmd_robot_loop_p99_seconds": (_GAUGE, "The lateness of the loop that 99 % stay below."),
    "swarmd_robot_loop_stalls_total": (_COUNTER, "Times that the daemon stood still."),
    "swarmd_robot_host_restarts_total": (_COUNTER, "Restarts of the pattern host."),
    "swarmd_robot_cpu_ratio": (_GAUGE, "The share of a core of a process over a second."),
    "swarmd_robot_memory_bytes": (_GAUGE, "The memory of a process."),
    "swarmd_robot_uptime_seconds": (_GAUGE, "Since the daemon of the robot began."),
    "swarmd_robot_incidents_total": (_COUNTER, "Incidents that this page has heard of."),
}
"""By name of a figure: its type and its help, in the order of the text."""


@dataclass(frozen=True, slots=True)
class Seen:
    """What a page knows of its swarm. Ages in s.

    `statuses`: by robot, the last status and its age. `look_age`: of `view`; None before the first
    look. `incidents`: by robot and kind, how many this page has heard of.
    """

    swarm: str
    version: str
    view: MembersView
    look_age: float | None
    statuses: Mapping[str, tuple[Status, float]]
    incidents: Mapping[tuple[str, str], int] = field(default_factory=dict)


def exposition(seen: Seen) -> str:
    """All figures; each family has its lines HELP and TYPE, and a family without figures none."""
    figures = _Figures()
    figures.add("swarmd_info", 1.0, swarm=seen.swarm, version=seen.version)
    _add_look(figures, seen)
    for name in sorted(seen.statuses):
        _add_status(figures, name, *seen.statuses[name])
    for (name, kind), count in sorted(seen.incidents.items()):
        figures.add("swarmd_robot_incidents_total", count, robot=name, kind=kind)
    return figures.text()


class _Figures:
    """The lines of each family."""

    def __init__(self) -> None:
        self._lines: dict[str, list[str]] = {family: [] for family in _FAMILIES}

    def add(self, family: str, value: float | None, **labels: str) -> None:
        """A figure; none for a value that is None."""
        if value is None:
            return
        inside = ",".join(f'{key}="{text.translate(_ESCAPES)}"' for key, text in labels.items())
        braced = f"{{{inside}}}" if inside else ""
        self._lines[family].append(f"{family}{braced} {_number(value)}\n")

    def add_one_of(
        self, family: str, robot: str, label: str, present: str, all_values: Iterable[str]
    ) -> None:
        """A figure for each value: 1 for the present one, 0 for the others."""
        for value in all_values:
            self.add(family, float(value == present), robot=robot, **{label: value})

    def text(self) -> str:
        parts: list[str] = []
        for family, lines in self._lines.items():
            kind, about = _FAMILIES[family]
            if lines:
                parts += [f"# HELP {family} {about}\n", f"# TYPE {family} {kind}\n", *lines]
        return "".join(parts)


def _number(value: float) -> str:
    """A number as the format writes it."""
    if math.isnan(value):
        return "NaN"
    if math.isinf(value):
        return "+Inf" if value > 0.0 else "-Inf"
    return f"{value:.12g}"


def _add_look(figures: _Figures, seen: Seen) -> None:
    """The figures of the last look."""
    age = seen.look_age
    figures.add("swarmd_look_age_seconds", age)
    if age is None or age > LOOK_SILENCE:
        return
    view = seen.view
    presences = {
        name: view.members[name].presence.value if name in view.members else NEVER_HEARD
        for name in sorted(view.members.keys() | view.roster)
    }
    for presence in _PRESENCES:
        count = sum(one == presence for one in presences.values())
        figures.add("swarmd_robots", count, presence=presence)
    for name, presence in presences.items():
        figures.add("swarmd_robot_up", float(presence == Presence.ALIVE), robot=name)
        figures.add_one_of("swarmd_robot_presence", name, "presence", presence, _PRESENCES)


def _add_status(figures: _Figures, name: str, status: Status, age: float) -> None:
    """The age of a robot's status, and its figures while it is new."""
    figures.add("swarmd_robot_status_age_seconds", age, robot=name)
    if age > STATUS_SILENCE:
        return
    figures.add(
        "swarmd_robot_info",
        1.0,
        robot=name,
        platform=status.platform,
        version=status.version,
    )
    figures.add("swarmd_robot_uptime_seconds", status.uptime + age, robot=name)
    _add_state(figures, name, status)
    _add_health(figures, name, status)


def _add_state(figures: _Figures, name: str, status: Status) -> None:
    """What the robot does, and why it does not move."""
    reason = status.reason
    figures.add_one_of("swarmd_robot_state", name, "state", status.state.value, map(str, State))
    if status.pattern is not None:
        figures.add("swarmd_robot_pattern_info", 1.0, robot=name, pattern=status.pattern)
    is_held = standing_of(status.state, reason or "") == "held"
    figures.add("swarmd_robot_held", float(is_held), robot=name)
    if isinstance(reason, Reason):
        figures.add("swarmd_robot_reason_info", 1.0, robot=name, reason=reason.value)
    figures.add("swarmd_robot_estops", len(status.latches), robot=name)
    decision = status.decision
    figures.add("swarmd_robot_obstacle_meters", decision.min_gap, robot=name)
    if status.state is State.RUNNING:
        figures.add("swarmd_robot_protection_active", float(decision.is_active), robot=name)


def _add_health(figures: _Figures, name: str, status: Status) -> None:
    """The measurements of the daemon itself, and the battery."""
    health = status.health
    figures.add("swarmd_robot_driver_up", float(health.driver_up), robot=name)
    charge = status.readings.get("battery")
    is_stale = "battery" in status.stale_readings
    if isinstance(charge, int | float) and not isinstance(charge, bool) and not is_stale:
        figures.add("swarmd_robot_battery_ratio", float(charge), robot=name)
    figures.add("swarmd_robot_scan_rate_hertz", health.scan_rate, robot=name)
    figures.add("swarmd_robot_loop_p99_seconds", health.loop_p99, robot=name)
    figures.add("swarmd_robot_loop_stalls_total", health.loop_stalls, robot=name)
    figures.add("swarmd_robot_host_restarts_total", health.host_restarts, robot=name)
    for process, usage in (("daemon", health.usage), ("pattern", health.pattern_usage)):
        if usage is not None:
            figures.add("swarmd_robot_cpu_ratio", usage.cpu, robot=name, process=process)
            figures.add("swarmd_robot_memory_bytes", usage.memory, robot=name, process=process)
