"""The status of a robot, assembled from its parts."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import msgspec

from swarmd.core.avoided import WayState
from swarmd.core.bounds import BoundedScalar
from swarmd.core.host_messages import ParamSources
from swarmd.core.messages import (
    BatterySummary,
    DecisionSummary,
    Health,
    Param,
    PeerFault,
    Reason,
    Status,
)
from swarmd.core.values import Platform, Scalar
from swarmd.core.verbs import shortened
from swarmd.robot.pattern_load import Loading
from swarmd.robot.protection.compatibility import barrier_settings
from swarmd.robot.protection.decision import Decision, LayerSettings
from swarmd.robot.protection.set_down import set_down
from swarmd.robot.sensors import Sensors
from swarmd.robot.state import MAX_TEXT, Lifecycle
from swarmd.settings.robot_settings import RobotSettings

if TYPE_CHECKING:
    from swarmd.robot.protection.protection import Protection
    from swarmd.robot.ticker import DutyCycle

MAX_REPORTED = 20
MAX_ROWS = 4
MAX_GAP = (
    1e6  # m, the bound of the message: odometry that jumps moves remembered obstacles far away
)
MAX_PEERS = 16
MAX_NEIGHBORS = 64
SCALAR: Any = BoundedScalar  # the type as msgspec reads it, with its bounds
MAX_NAME = 64
MAX_VALUE = 256
_SAME_PLACE = 0.4  # m between a sensed neighbour and an avoided object that count as the same


def make_status(
    lifecycle: Lifecycle,
    sensors: Sensors,
    decision: Decision,
    duty: DutyCycle,
    now: float,
    protection: Protection,
    held_for: float | None = None,
    peer_faults: tuple[PeerFault, ...] = (),
) -> Status:
    """The status that a robot publishes, in the bounds of the message: long texts are cut.

    `duty`: the share of the run's ticks in which protection was active. `now` and all times of the
    lifecycle are in s on the own clock; the status contains durations in s. The daemon adds the
    health of its own loop. `held_for`: see `StandingWatch.held_for`.
    `peer_faults`: what peers tell of robots.
    """
    identity = lifecycle.identity
    setup = lifecycle.identity.setup
    machine = lifecycle.state_machine
    running = lifecycle.pattern_run.running
    reason = status_reason(lifecycle, decision)
    neighbors = sensors.neighbors(now)[:MAX_NEIGHBORS]
    passage = protection.passage
    return Status(
        robot=identity.robot,
        instance=identity.instance,
        platform=identity.platform.name,
        driver=setup.driver,
        host=setup.host,
        profile=setup.profile,
        is_secured=setup.is_secured,
        state=machine.state,
        reason=reason,
        detail=_detail(lifecycle, sensors, reason, now),
        pattern=None if running is None else running.pattern,
        generation=lifecycle.pattern_run.generation,
        since=max(now - machine.since, 0.0),
        epoch=lifecycle.epoch,
        changed_by=lifecycle.changed_by,
        latches=lifecycle.latches.aged(now),
        labels=lifecycle.goals.labels,
        params={} if running is None else _params(running.values),
        report=_clean(lifecycle.report),
        decision=decision_summary(decision, duty, sensors, now),
        health=_health(lifecycle, sensors, now),
        uptime=max(now - lifecycle.born, 0.0),
        readings=_clean(sensors.readings),
        stale_readings=tuple(name[:MAX_NAME] for name in sensors.stale_readings[:MAX_REPORTED]),
        events=tuple(lifecycle.events),
        version=setup.version,
        kernels=setup.kernels,
        scan_delay=sensors.scan_delay.summary(now),
        body=sensors.peers.own,
        peers=sensors.peers.findings(now)[:MAX_PEERS],
        passage=passage,
        battery=_battery(lifecycle),
        findings=protection.findings,
        not_following=protection.not_following,
        neighbors=tuple(neighbor.id for neighbor in neighbors),
        places=tuple(
            f"{one.id} at {one.distance:.2f} m, {math.degrees(one.bearing):.0f} deg"
            for one in neighbors
            if one.distance is not None and one.bearing is not None
        ),
        goal=lifecycle.goals.status(now),
        words=dict(identity.platform.words.get(setup.driver, {})),
        set_down=set_down(identity.platform, passage),
        held_for=held_for,
        driven_by=_driver(lifecycle),
        peer_faults=peer_faults[:MAX_PEERS],
        **_layers(identity.platform, setup.settings, sensors, decision, protection, now),
    )


_DETAILED = Reason.NO_POSE, Reason.HAZARD, Reason.INVALID_SCAN, Reason.STALE_ODOMETRY
"""Holds of which the sensors know more than the reason."""


def _detail(lifecycle: Lifecycle, sensors: Sensors, reason: Reason | None, now: float) -> str:
    """What a load waits for, else why the run is held, else the last change of state, as text."""
    loading = lifecycle.pattern_run.loading
    if loading is not None:
        return _loading_text(loading, now)
    hand = lifecycle.pattern_run.hand
    if reason is Reason.HAND_LOST and hand is not None:
        return f"that of {hand.driver} {hand.lost_text}"
    if reason in _DETAILED and (lifecycle.is_running or lifecycle.is_driven):
        return sensors.hold_text(reason, now)[:MAX_VALUE]
    if lifecycle.latches.held:  # a reset may have cleared others since the change of state
        return shortened(lifecycle.latches.text, MAX_TEXT)
    return lifecycle.state_machine.detail


def _driver(lifecycle: Lifecycle) -> str:
    """Who drives the robot by hand; empty without one."""
    hand = lifecycle.pattern_run.hand
    return "" if hand is None or not hand.is_driving else hand.driver


def _health(lifecycle: Lifecycle, sensors: Sensors, now: float) -> Health:
    """The health of scans, driver, pattern host and messages."""
    dropped_messages = {
        "msg:inbox_full": sensors.inbox.overflowed,
        "msg:not_a_neighbor": sensors.rejected,
        "msg:wrong_type": lifecycle.wrong_type_count,
        "msg:too_much_said": lifecycle.outbox.dropped,
        "drive:ignored": lifecycle.ignored_commands,
    }
    return Health(
        scan_rate=sensors.scan_rate(now),
        host_restarts=lifecycle.pattern_run.restarts,
        driver=sensors.driver_text[:MAX_VALUE],
        driver_up=sensors.is_driver_up,
        dropped={kind: count for kind, count in dropped_messages.items() if count},
    )


def _layers(
    platform: Platform,
    settings: RobotSettings,
    sensors: Sensors,
    decision: Decision,
    protection: Protection,
    now: float,
) -> dict[str, Any]:
    """The summaries of the layers in use, by their fields of the status."""
    barrier = barrier_settings(platform)
    layers: dict[str, LayerSettings] = {**(barrier.layers if barrier else {}), **settings.layers}
    views = protection.views(sensors.context(now)) if settings.layers else ()
    view_of = dict(zip(settings.layers, views, strict=True))
    return {
        key: layer.summary(
            protection.findings,
            view_of.get(key),
            decision.is_bounded,
            sensors.pose_text(now)[:MAX_VALUE],
        )
        for key, layer in layers.items()
    }


def _params(values: ParamSources) -> dict[str, Param]:
    """By parameter: its value, and the source of the value, such as `platform` or `request`."""
    return {name: Param(value=value, source=source) for name, (value, source) in values.items()}


def _battery(lifecycle: Lifecycle) -> BatterySummary | None:
    settings = lifecycle.identity.setup.settings.on_low_battery
    battery = lifecycle.battery
    if settings is None:
        return None
    run = lifecycle.pattern_run
    present = run.running or run.loading
    return BatterySummary(
        charge=battery.charge,
        below=settings.below,
        is_low=battery.is_low,
        pattern=settings.pattern,
        runs=present is not None and present.wish.is_own,
    )


def _loading_text(loading: Loading, now: float) -> str:
    if loading.start_at is None:
        return f"loading {loading.pattern}"
    return f"{loading.pattern} starts in {max(loading.start_at - now, 0.0):.1f} s"


def status_reason(lifecycle: Lifecycle, decision: Decision) -> Reason | None:
    """The one reason why the robot does not move; None while the robot moves."""
    is_decided = lifecycle.is_running or lifecycle.is_driven
    return decision.reason if is_decided else lifecycle.state_machine.reason


def _avoided(decision: Decision, sensors: Sensors, now: float) -> str:
    """The text of avoidance, with the id of the neighbour that is sensed at the avoided object."""
    avoided = decision.avoided
    if avoided is None:
        return ""
    is_object = avoided.way is WayState.NONE
    for neighbor in sensors.neighbors(now) if is_object else ():
        if neighbor.distance is None or neighbor.bearing is None:
            continue
        off = math.remainder(neighbor.bearing - avoided.bearing, 2.0 * math.pi)
        apart = abs(neighbor.distance - avoided.distance) + avoided.distance * abs(off)
        if apart < _SAME_PLACE:
            return f"avoiding {neighbor.id}"
    return avoided.text


def decision_summary(
    decision: Decision, duty: DutyCycle, sensors: Sensors, now: float
) -> DecisionSummary:
    """A decision within the bounds of a message, with the text of avoidance."""
    return _summary(decision, duty, _avoided(decision, sensors, now))


def _summary(decision: Decision, duty: DutyCycle, avoiding: str = "") -> DecisionSummary:
    return DecisionSummary(
        mode=decision.mode,
        is_active=decision.is_active,
        requested_linear=decision.requested.linear,
        requested_angular=decision.requested.angular,
        requested_lateral=decision.requested.lateral,
        safe_linear=decision.safe.linear,
        safe_angular=decision.safe.angular,
        safe_lateral=decision.safe.lateral,
        min_gap=decision.min_gap,
        scan_age=decision.scan_age,
        rows=tuple(row for row in decision.rows[:MAX_ROWS] if row.gap <= MAX_GAP),
        is_recovering=decision.is_recovering,
        duty=duty.share,
        decisions=duty.decisions,
        speed_share=decision.speed_share,
        avoiding=avoiding,
    )


def _clean(report: Mapping[str, Scalar]) -> dict[str, Scalar]:
    """The entries of a report, or of readings, that fit the bounds of a status."""
    cleaned: dict[str, Scalar] = {}
    for name, value in list(report.items())[:MAX_REPORTED]:
        short = value[:MAX_VALUE] if isinstance(value, str) else value
        try:
            cleaned[name[:MAX_NAME]] = msgspec.convert(short, SCALAR)
        except msgspec.ValidationError:
            continue
    return cleaned
