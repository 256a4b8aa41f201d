"""The whole status of a robot in titled groups of lines."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from types import MappingProxyType
from typing import Any

from swarmd.core.messages import (
    BatterySummary,
    Body,
    LimitingObstacle,
    Member,
    NarrowestPassage,
    Presence,
    ScanDelaySummary,
    State,
    Status,
)
from swarmd.protection.fence.fence_settings import fence_text
from swarmd.protection.walls.walls_settings import walls_stand_text
from swarmd.texts.keys import day
from swarmd.texts.values import NOTHING, megabytes, quantity, sandbox_text, seconds, short_number
from swarmd.texts.why import activity, obstacles, stop_text

_LEAST_COST = 0.005  # m/s that the text names

NOT_DESCRIBED: Mapping[str, Any] = MappingProxyType({})


def sections(
    member: Member, status: Status, described: Mapping[str, Any] = NOT_DESCRIBED
) -> list[tuple[str, list[tuple[str, str]]]]:
    """The status without events, in titled groups of (name, value) lines; a group may be empty.

    `described`: what `describe_patterns` gives of the pattern, for the units of its values.
    """
    seen = "now" if member.presence is Presence.ALIVE else f"{seconds(member.age)} ago"
    return [
        ("Robot", _robot(status, seen)),
        ("State", _state(status)),
        ("Emergency stops", [(i, _latch(status, i)) for i in sorted(status.latches)]),
        ("Protection", _protection(status)),
        ("Peers", [(f.robot, f"holds it: {f.text}" if f.holds else f.text) for f in status.peers]),
        ("Parameters", _parameters(status, described)),
        (_report_title(status), _report(status, described)),
        ("Readings", _readings(status)),
        ("Health", _health(status)),
        ("Meaning of words", list(status.words.items())),
        ("Dropped", [(kind, str(count)) for kind, count in sorted(status.health.dropped.items())]),
    ]


def sections_with_events(
    member: Member, status: Status, described: Mapping[str, Any] = NOT_DESCRIBED
) -> list[tuple[str, list[tuple[str, str]]]]:
    """As `sections`, with the last events as the last group."""
    events = [(f"{seconds(status.uptime - e.at)} ago", e.text) for e in status.events[-10:]]
    return [*sections(member, status, described), ("Events", events)]


def _readings(status: Status) -> list[tuple[str, str]]:
    stale = "stale: no fresh value; patterns get none"
    texts = {name: short_number(value) for name, value in status.readings.items()}
    return sorted({**texts, **dict.fromkeys(status.stale_readings, stale)}.items())


def _report(status: Status, described: Mapping[str, Any]) -> list[tuple[str, str]]:
    units = described.get("report_units", {})
    return [(name, quantity(value, units.get(name))) for name, value in status.report.items()]


def _report_title(status: Status) -> str:
    if status.state is State.RUNNING:
        return "Report"
    return f"Last report (the run has ended: {status.state} for {seconds(status.since)})"


def _robot(status: Status, seen: str) -> list[tuple[str, str]]:
    secured = "secured" if status.is_secured else "insecure"
    if status.keys is not None:
        secured += (
            f", roster {status.keys.generation}, certificate until {day(status.keys.expires)}"
        )
    return [
        ("platform", status.platform),
        ("body", NOTHING if status.body is None else body_text(status.body)),
        ("driver", f"{status.driver} {'(up)' if status.health.driver_up else '(lost)'}"),
        ("host", status.host),
        ("version", status.version or NOTHING),
        ("kernels", status.kernels or NOTHING),
        ("network", f"profile {status.profile}, {secured}"),
        ("labels", ", ".join(status.labels) or NOTHING),
        ("instance", status.instance),
        ("up for", seconds(status.uptime)),
        ("seen", seen),
    ]


def body_text(body: Body) -> str:
    """The body that a robot reports to other robots, in one line."""
    text = f"surfaces of up to {body.surface_speed:.2f} m/s"
    if body.scan_plane is None or body.lowest is None or body.highest is None:
        return f"{text}; its platform has no heights"
    seen = f"seen between {body.lowest:.3f} and {body.highest:.3f} m"
    return f"{text}; scan plane at {body.scan_plane:.3f} m; {seen}"


def passage_text(passage: NarrowestPassage) -> str:
    """The narrowest passages in one line, in whole centimetres that suffice."""
    door, corridor, meeting = (
        f"{math.ceil(100.0 * width - 1e-6) / 100.0:.2f} m"
        for width in (passage.door, passage.corridor, passage.meeting)
    )
    return (
        f"doors of {door} and corridors of {corridor} or wider: its width and the gap that"
        f" protection keeps on each side; corridors of {meeting} let two such robots pass each"
        " other, with a gap between them too"
    )


def _state(status: Status) -> list[tuple[str, str]]:
    return [
        ("state", f"{status.state} for {seconds(status.since)}"),
        ("reason", status.reason or NOTHING),
        ("detail", status.detail or NOTHING),
        ("pattern", status.pattern or NOTHING),
        ("generation", str(status.generation)),
        ("revision", str(status.epoch.revision)),
        ("changed by", status.changed_by or NOTHING),
        *([] if status.battery is None else [("battery", battery_text(status.battery))]),
    ]


def battery_text(battery: BatterySummary) -> str:
    """The charge, and what happens or has happened at a low charge, in one line."""
    act = "the robot stands" if battery.pattern is None else f"the robot runs {battery.pattern}"
    charge = "no fresh reading" if battery.charge is None else f"{battery.charge:.2f}"
    if not battery.is_low:
        return f"{charge}; below {battery.below:g} {act}"
    has_run = f"; {act}" if battery.runs else ""
    return f"{charge}: low, since it was below {battery.below:g}{has_run}"


def _latch(status: Status, latch_id: str) -> str:
    latch = status.latches[latch_id]
    return f"for {latch.scope}, {stop_text(latch)}"


def _titled(title: str, texts: Iterable[str]) -> list[tuple[str, str]]:
    """Rows of texts; only the first row has the title."""
    return [("" if number else title, text) for number, text in enumerate(texts)]


def _protection(status: Status) -> list[tuple[str, str]]:
    decision = status.decision
    gap, age = decision.min_gap, decision.scan_age
    limits = [f"{text}, {_cap_text(row)}" for text, row in obstacles(decision.rows)]
    return [
        ("mode", f"{decision.mode}, {activity(decision)}"),
        (
            "requested",
            _twist_text(
                decision.requested_linear, decision.requested_angular, decision.requested_lateral
            ),
        ),
        ("safe", _twist_text(decision.safe_linear, decision.safe_angular, decision.safe_lateral)),
        *_titled("limited by", limits),
        ("nearest", NOTHING if gap is None else f"{gap:.2f} m"),
        ("scan age", NOTHING if age is None else seconds(age)),
        ("passes", NOTHING if status.passage is None else passage_text(status.passage)),
        *([("walls stand", walls_stand_text(status.walls_stand))] if status.walls_stand else []),
        *([("fence", fence_text(status.fence))] if status.fence else []),
        *_scan_delay(status.scan_delay),
        *_titled("findings", status.findings),
        *([("base", status.not_following)] if status.not_following else []),
        ("active for", f"{decision.duty:.0%} of {decision.decisions} decisions since run"),
    ]


def _cap_text(row: LimitingObstacle) -> str:
    """The cap of a limiting obstacle, and what the age of its ray takes off the cap."""
    text = f"at most {row.cap:z.2f} m/s"
    if row.age is None:
        return text
    cost = f", which costs {row.age_cost:.2f} m/s" if row.age_cost >= _LEAST_COST else ""
    return f"{text}; seen {row.age:.2f} s ago{cost}"


def _scan_delay(delay: ScanDelaySummary | None) -> list[tuple[str, str]]:
    if delay is None:
        return []
    used = seconds(delay.declared + delay.added)
    most = seconds(delay.declared + delay.bound)
    text = f"declared {seconds(delay.declared)}, used {used}, hold beyond {most}"
    return [("scan delay", text), *(("", figure.line) for figure in delay.figures)]


def _parameters(status: Status, described: Mapping[str, Any]) -> list[tuple[str, str]]:
    units = {spec["name"]: spec["unit"] for spec in described.get("params", ())}
    texts = {name: quantity(param.value, units.get(name)) for name, param in status.params.items()}
    width = max(map(len, texts.values()), default=0)
    return [
        (name, f"{text.ljust(width)}  from {status.params[name].source}")
        for name, text in texts.items()
    ]


def _health(status: Status) -> list[tuple[str, str]]:
    health = status.health
    return [
        ("scan rate", f"{health.scan_rate:.1f} Hz"),
        ("loop p99", seconds(health.loop_p99)),
        ("loop stalls", str(health.loop_stalls)),
        ("host restarts", str(health.host_restarts)),
        *(
            (name, f"{usage.cpu:.0%} of a core, {megabytes(usage.memory)}")
            for name, usage in (("daemon", health.usage), ("pattern host", health.pattern_usage))
            if usage is not None
        ),
        *([] if health.sandbox is None else [("sandbox", sandbox_text(health.sandbox))]),
        ("driver", health.driver or NOTHING),
        ("network", health.network or NOTHING),
        *([("storage", health.storage)] if health.storage else []),
        ("neighbors", ", ".join(status.neighbors) or NOTHING),
    ]


def _twist_text(linear: float, angular: float, lateral: float) -> str:
    """Such as `0.100 m/s, 0.500 rad/s`; with the lateral speed if the base slides sideways."""
    sideways = f", {lateral:z.3f} m/s to the left" if lateral else ""
    return f"{linear:z.3f} m/s, {angular:z.3f} rad/s{sideways}"
