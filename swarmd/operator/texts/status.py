"""The whole status of a robot in titled groups of lines."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from types import MappingProxyType
from typing import Any

from swarmd.core.messages import (
    BatterySummary,
    Body,
    Epoch,
    FenceSummary,
    LimitingObstacle,
    Member,
    NarrowestPassage,
    PeerFault,
    Presence,
    ProcessUsage,
    RecordingSummary,
    Sandbox,
    ScanDelaySummary,
    SetDown,
    State,
    Status,
    WallsStandSummary,
)
from swarmd.operator.texts.keys import day
from swarmd.operator.texts.shown_fields import Texts, shown_lines
from swarmd.operator.texts.values import (
    centimetres,
    megabytes,
    quantity,
    sandbox_text,
    seconds,
    short_number,
)
from swarmd.operator.texts.why import activity, obstacles, stop_text
from swarmd.robot.protection.fence.fence_settings import fence_text
from swarmd.robot.protection.walls.walls_settings import walls_stand_text

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
        ("Emergency stops", [(i, stop_text(one)) for i, one in sorted(status.latches.items())]),
        ("Protection", _protection(status)),
        ("Peers", [(f.robot, f"holds it: {f.text}" if f.holds else f.text) for f in status.peers]),
        ("Told by peers", [_peer_fault(fault) for fault in status.peer_faults]),
        ("Parameters", _parameters(status, described)),
        (_report_title(status), _report(status, described)),
        ("Readings", _readings(status)),
        (
            "Health",
            [*shown_lines(status.health, "Health", _TEXTS), *shown_lines(status, "Health", _TEXTS)],
        ),
        ("Meaning of words", list(status.words.items())),
        ("Dropped", [(kind, str(count)) for kind, count in sorted(status.health.dropped.items())]),
    ]


def sections_with_events(
    member: Member, status: Status, described: Mapping[str, Any] = NOT_DESCRIBED
) -> list[tuple[str, list[tuple[str, str]]]]:
    """As `sections`, with the last events as the last group."""
    events = [(f"{seconds(status.uptime - e.at)} ago", e.text) for e in status.events[-10:]]
    return [*sections(member, status, described), ("Events", events)]


def _peer_fault(fault: PeerFault) -> tuple[str, str]:
    """The robot of a fault that peers tell, and the fault with its time and who tells it."""
    told_by = f"; told by {', '.join(fault.tellers)}" if fault.tellers else ""
    return fault.robot, f"{fault.text}; for {seconds(fault.since)}{told_by}"


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
        *shown_lines(status, "Robot", _TEXTS),
        ("driver", f"{status.driver} {'(up)' if status.health.driver_up else '(lost)'}"),
        ("network", f"profile {status.profile}, {secured}"),
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
        centimetres(width) for width in (passage.door, passage.corridor, passage.meeting)
    )
    return (
        f"doors of {door} and corridors of {corridor} or wider: its width and the gap that"
        f" protection keeps on each side; corridors of {meeting} let two such robots pass each"
        " other, with a gap between them too"
    )


def set_down_text(one: SetDown) -> str:
    """Where the robot may be set down, in one line, in whole centimetres that suffice."""
    text = f"{centimetres(one.gap)} or more from a wall or another obstacle, farther from a corner"
    if one.lidar is not None:
        text += f", and {one.lidar:.2f} m around its lidar free"
    return f"{text}; nearer it may stand, or leave at a creep"


def _state(status: Status) -> list[tuple[str, str]]:
    state = f"{status.state} for {seconds(status.since)}"
    return [("state", state), *shown_lines(status, "State", _TEXTS)]


def battery_text(battery: BatterySummary) -> str:
    """The charge, and what happens or has happened at a low charge, in one line."""
    act = "the robot stands" if battery.pattern is None else f"the robot runs {battery.pattern}"
    charge = "no fresh reading" if battery.charge is None else f"{battery.charge:.2f}"
    if not battery.is_low:
        return f"{charge}; below {battery.below:g} {act}"
    has_run = f"; {act}" if battery.runs else ""
    return f"{charge}: low, since it was below {battery.below:g}{has_run}"


def _titled(title: str, texts: Iterable[str]) -> list[tuple[str, str]]:
    """Rows of texts; only the first row has the title."""
    return [("" if number else title, text) for number, text in enumerate(texts)]


def _protection(status: Status) -> list[tuple[str, str]]:
    decision = status.decision
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
        *shown_lines(decision, "Protection", _TEXTS),
        *shown_lines(status, "Protection", _TEXTS),
        *_scan_delay(status.scan_delay),
        *_titled("findings", status.findings),
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


def _twist_text(linear: float, angular: float, lateral: float) -> str:
    """Such as `0.100 m/s, 0.500 rad/s`; with the lateral speed if the base slides sideways."""
    sideways = f", {lateral:z.3f} m/s to the left" if lateral else ""
    return f"{linear:z.3f} m/s, {angular:z.3f} rad/s{sideways}"


_TEXTS: Texts = MappingProxyType(
    {
        BatterySummary: battery_text,
        Body: body_text,
        Epoch: lambda epoch: str(epoch.revision),
        FenceSummary: fence_text,
        NarrowestPassage: passage_text,
        ProcessUsage: lambda usage: f"{usage.cpu:.0%} of a core, {megabytes(usage.memory)}",
        RecordingSummary: lambda one: f"{one.file}, {megabytes(one.size)}, {one.dropped} dropped",
        Sandbox: sandbox_text,
        SetDown: set_down_text,
        WallsStandSummary: walls_stand_text,
    }
)
