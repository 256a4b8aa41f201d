"""A robot whose inputs and decisions are recorded, so that a replay can repeat them."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from swarmd.core.errors import fail_stop
from swarmd.core.goal import Goal
from swarmd.core.hazard import Hazard
from swarmd.core.host_messages import HostEvent, Stepped
from swarmd.core.messages import Body, Latch, Reason, Status
from swarmd.core.values import (
    ZERO,
    Neighbor,
    Odometry,
    PeerPlace,
    Scan,
    SharedPose,
    Value,
)
from swarmd.core.verbs import Request
from swarmd.daemon.recorder import Recorder
from swarmd.recording import frames
from swarmd.robot.actions import Actions
from swarmd.robot.robot import Robot


class RecordedRobot(Robot):
    """A `Robot` that hands each input with its time, and each decision, to a recorder.

    An error within it is a `CoreFault`: nothing that calls it may go on.
    """

    def __init__(self, *args: Any, recorder: Recorder, **kwargs: Any) -> None:
        self._recorder = recorder
        self._logged_to = -1.0
        self._provisional: tuple[int, ...] = ()
        super().__init__(*args, **kwargs)

    @fail_stop
    def on_scan(self, scan: Scan, now: float) -> Actions:
        """A raw scan arrived."""
        self._recorder.scan(scan, now)
        return self._decided("scan", now, super().on_scan(scan, now))

    @fail_stop
    def on_ranges(self, scan: Scan, now: float) -> Actions:
        """A raw scan of the ring of range sensors arrived."""
        self._recorder.scan(scan, now, "/ranges")
        return self._decided("ranges", now, super().on_ranges(scan, now))

    @fail_stop
    def on_odometry(self, odometry: Odometry, now: float) -> None:
        """A measured pose and twist arrived."""
        self._recorder.add(frames.OdometryEntry(now, odometry))
        super().on_odometry(odometry, now)

    @fail_stop
    def on_neighbors(self, neighbors: tuple[Neighbor, ...], now: float) -> None:
        """The present neighbours."""
        self._recorder.latest("neighbors", frames.NeighborsEntry(now, neighbors))
        super().on_neighbors(neighbors, now)

    @fail_stop
    def on_peers(self, bodies: Mapping[str, Body | None], now: float) -> None:
        """What the other robots tell of their bodies."""
        entry = frames.TextEntry(now, "/peers", frames.as_json(bodies))
        self._recorder.latest("peers", entry)
        super().on_peers(bodies, now)

    @fail_stop
    def on_pose(self, pose: SharedPose, now: float) -> None:
        """The robot's own pose in a frame that robots share."""
        self._recorder.add(frames.PoseEntry(now, pose))
        super().on_pose(pose, now)

    @fail_stop
    def on_peer_place(self, place: PeerPlace, now: float) -> None:
        """Where a peer says that it is in a shared frame."""
        self._recorder.text("/peer_place", place, now)
        super().on_peer_place(place, now)

    @fail_stop
    def on_readings(self, readings: Mapping[str, float]) -> None:
        """Scalar sensor readings by name."""
        self._recorder.latest("readings", frames.ReadingsEntry(self._last_tick, dict(readings)))
        super().on_readings(readings)

    @fail_stop
    def on_hazards(self, hazards: tuple[Hazard, ...], now: float) -> Actions:
        """All hazards that the base senses now."""
        entry = frames.TextEntry(now, "/hazards", frames.as_json(hazards))
        self._recorder.latest("hazards", entry)
        return self._decided("hazards", now, super().on_hazards(hazards, now))

    @fail_stop
    def on_message(self, sender: str, name: str, value: Value, now: float) -> bool:
        """A message of another robot's pattern."""
        self._recorder.add(frames.MessageEntry(now, sender, name, value))
        return super().on_message(sender, name, value, now)

    @fail_stop
    def on_driver(
        self,
        is_up: bool,
        text: str,
        now: float,
        *,
        hold: Reason | None = None,
        gets_zero: bool = False,
    ) -> Actions:
        """The driver is connected or lost."""
        entry = frames.DriverEntry(now, is_up, text, str(hold or ""), gets_zero)
        self._recorder.latest("driver", entry)
        actions = super().on_driver(is_up, text, now, hold=hold, gets_zero=gets_zero)
        return self._decided("driver", now, actions)

    @fail_stop
    def on_host(self, event: HostEvent, now: float) -> Actions:
        """An event of the pattern host arrived."""
        self._record_provisional(now)
        if self._recorder.is_on:
            self._recorder.add(frames.HostEntry(now, frames.encode_host(event)))
            if isinstance(event, Stepped):
                twist = ZERO if event.outputs.twist is None else event.outputs.twist
                self._recorder.add(frames.RequestedEntry(now, twist, event.scan_seq))
        return self._decided("host", now, super().on_host(event, now))

    @fail_stop
    def on_request(self, request: Request, now: float) -> Actions:
        """A request arrived."""
        self._recorder.text("/request", request, now)
        return self._decided("request", now, super().on_request(request, now))

    @fail_stop
    def on_code_changed(self, now: float) -> Actions:
        """The code of patterns was replaced or removed."""
        self._recorder.text("/code_changed", None, now)
        return self._decided("code", now, super().on_code_changed(now))

    @fail_stop
    def on_latches(self, latches: Mapping[str, Latch], now: float) -> Actions:
        """A peer holds latches."""
        self._recorder.text("/latches", latches, now)
        return self._decided("latches", now, super().on_latches(latches, now))

    @fail_stop
    def on_goal(self, goal: Goal, age: float | None, now: float, *, may_join: bool) -> Actions:
        """A peer holds a goal."""
        self._recorder.text("/goal", (goal, age, may_join), now)
        return self._decided("goal", now, super().on_goal(goal, age, now, may_join=may_join))

    @fail_stop
    def forget_goals(self, digests: tuple[str, ...], now: float) -> Actions:
        """Goals whose issuers are not operators any more."""
        self._recorder.text("/forget_goals", digests, now)
        return self._decided("roster", now, super().forget_goals(digests, now))

    @fail_stop
    def on_run_lease(self, goal: str, count: int, now: float) -> None:
        """The operator of a goal is there."""
        self._recorder.text("/run_lease", (goal, count), now)
        super().on_run_lease(goal, count, now)

    @fail_stop
    def on_duplicate(self, holder: str | None, now: float) -> Actions:
        """Another instance has this id."""
        self._recorder.text("/duplicate", holder, now)
        return self._decided("duplicate", now, super().on_duplicate(holder, now))

    @fail_stop
    def on_network_changed(self, text: str, now: float) -> Actions:
        """The daemon speaks on another network."""
        self._recorder.text("/network", text, now)
        return self._decided("network", now, super().on_network_changed(text, now))

    @fail_stop
    def on_roster(self, text: str, now: float, *, is_revoked: bool) -> Actions:
        """The daemon takes a roster."""
        self._recorder.text("/roster", (text, is_revoked), now)
        return self._decided("roster", now, super().on_roster(text, now, is_revoked=is_revoked))

    @fail_stop
    def tick(self, now: float) -> Actions:
        """Check all deadlines."""
        self._record_provisional(now)
        actions = self._decided("tick", now, super().tick(now))
        self._recorder.flush_if_due(now)
        return actions

    def _record_provisional(self, now: float) -> None:
        """Record which of the patterns that run or load are provisional: their faults end runs."""
        run, settings = self._run, self._lifecycle.identity.settings
        current = tuple(
            one.generation
            for one in (run.running, run.loading)
            if one is not None and settings.is_provisional(one.generation)
        )
        if current != self._provisional:
            self._provisional = current
            entry = frames.TextEntry(now, "/provisional", frames.as_json(current))
            self._recorder.latest("provisional", entry)

    def _decided(self, cause: str, now: float, actions: Actions) -> Actions:
        recorder = self._recorder
        if not recorder.is_on:
            return actions
        reason = actions.decision.reason or ""
        recorder.add(frames.DecisionEntry(now, cause, self.state, reason, actions.decision))
        for channel, value in actions.messages.items():
            recorder.add(frames.MessageEntry(now, self.id, channel, value))
        if actions.status is not None:
            self._record_status(actions.status, now)
        return actions

    def _record_status(self, status: Status, now: float) -> None:
        self._recorder.text("/status", status, now)
        for event in status.events:
            if event.at > self._logged_to:
                self._logged_to = event.at
                at = now - status.uptime + event.at
                if at >= self._recorder.began:  # else the file would begin with an empty time
                    self._recorder.add(frames.EventEntry(at, event.text))
