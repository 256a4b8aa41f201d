"""Part B: after which time and way the base rests."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from msgspec.structs import replace

from swarmd.core.messages import State
from swarmd.core.values import Array, Platform
from swarmd.operator.acceptance.evidence import Evidence, Samples
from swarmd.operator.acceptance.step import Judge
from swarmd.operator.acceptance.verdict import Result, Verdict, failed, not_shown, passed
from swarmd.operator.calibration.estimators import CRUISE, Braking, stop_of

LEASE = 2.0
"""Seconds for which a run goes on without its operator: the lease of each run of the test."""
ABSENCE = 120.0
"""Seconds in which a person ends and restores a daemon, a link or a bridge."""
STOP_TIME = 0.5
"""Seconds from a stop to rest, beside the braking: ticks, the link to the base, odometry."""
END_TIME = 1.3
"""As STOP_TIME, after the daemon or its link to the base has ended: the base stops within 0.6 s
(docs/safety.md), and the last 0.5 s of a killed daemon are not in its recording."""
HOVER_DRIFT = 0.03
"""m/s at which a drone that hovers may drift; our guess."""
_DRIFT_TIME = 0.2  # s before and after, over which a drift is told from a flight
_HOVER_TIME = 2.0  # s of hovering that are looked at; land_after is longer
_AT_REST = 0.001  # m: a base that moves no farther rests
_LEAST_CRUISE = 0.02  # m/s
_STOOD = 0.01  # m that a base which its button has stopped may move
_WHOLE_RUN = 0.8  # share of the time of a run that was not ended early
_GOES_ON = 0.5  # share of the cruise at the end of the recording: the base does not brake
_PAUSE = 0.75 * LEASE  # s between two words of the operator: the lease is renewed four times
_LEAST_GAP = 0.7  # s without odometry, after which the daemon or its link had ended


def after_stop(latched: bool = False) -> Judge:
    """A judge of the time from an operator's stop to rest; `latched`: of an emergency stop."""

    def judge(evidence: Evidence) -> Verdict:
        if not evidence.samples.stops:
            return not_shown("no stop arrived at the robot")
        verdict = _rest_after(evidence, evidence.samples.stops[0], STOP_TIME)
        status = evidence.status
        if not latched or verdict.result is not Result.PASS:
            return verdict
        if status is None or status.state is not State.ESTOPPED:
            return failed("it rests, and is not emergency-stopped")
        verdict.values["instance"] = status.instance
        return verdict

    return judge


def after_silence(evidence: Evidence) -> Verdict:
    """The time from the last word of the operator to rest."""
    leases = evidence.samples.leases
    if not leases:
        return not_shown("no lease arrived at the robot")
    pauses = np.diff(leases, append=math.inf)
    last = leases[int(np.flatnonzero(pauses > _PAUSE)[0])]
    verdict = _rest_after(evidence, last, LEASE + STOP_TIME)
    late = [one for one in evidence.samples.decisions if one.at > last + LEASE + STOP_TIME]
    if verdict.result is Result.FAIL and any(not one.safe.is_zero for one in late):
        reason = "the daemon drove on without its operator: the run lease did not end the run"
        return replace(verdict, reason=reason)
    return verdict


def across_gap(what: str) -> Judge:
    """A judge of the way that a base drove while no odometry came.

    `what`: what has to stop the base then, in words.
    """

    def judge(evidence: Evidence) -> Verdict:
        track = track_of(evidence.samples)
        gaps = np.diff(track[:, 0])
        if not len(gaps) or gaps.max() < _LEAST_GAP:
            return not_shown("odometry did not pause, or did not come back: nothing had ended")
        last = int(gaps.argmax())
        cruise = track[: last + 1]
        cruise = cruise[cruise[:, 0] >= cruise[-1, 0] - CRUISE]
        way = math.hypot(*(cruise[-1, 1:3] - cruise[0, 1:3]))
        speed = way / max(float(cruise[-1, 0] - cruise[0, 0]), 1e-3)
        if speed < _LEAST_CRUISE:
            return not_shown("it did not drive when it happened; repeat it earlier")
        on = math.hypot(*(track[last + 1, 1:3] - track[last, 1:3]))
        seconds = on / speed
        bound = END_TIME + 0.5 * speed / _braking(evidence.platform)
        values = {"way": on, "seconds": seconds}
        figure = f"{on:.2f} m, as in {seconds:.1f} s"
        if seconds > bound:
            return failed(f"the base drove on: {what}", figure, f"{bound:.1f} s", **values)
        return passed("the base stopped by itself", figure, f"{bound:.1f} s", **values)

    return judge


def own_stop(seconds: float) -> Judge:
    """A judge of the base's own stop button, pressed in a run of `seconds`, released after it."""

    def judge(evidence: Evidence) -> Verdict:
        commanded = [one.at for one in evidence.samples.decisions if not one.safe.is_zero]
        track = track_of(evidence.samples)
        if not commanded or len(track) < 2:
            return not_shown("nothing was commanded, or no odometry came")
        begin = commanded[0]
        end = commanded[-1]
        last = float(track[-1, 0])

        def way(since: float, until: float) -> float:
            return float(np.ptp(np.interp((since, until), track[:, 0], _ways(track))))

        if way(begin, last) < _LEAST_CRUISE:
            return not_shown("it did not drive: release its stop button, and repeat the step")
        # The run has ended early where the driver tells the daemon of the button.
        drove = 0.0 if end - begin < _WHOLE_RUN * seconds else way(end - 1.0, end)
        if drove > _STOOD:
            return failed(
                "it drove to the end of its run: the button was not pressed, was released before,"
                " or does not stop the base",
                f"{drove:.2f} m in the last second",
                f"{_STOOD} m",
            )
        later = way(end + END_TIME, max(last, end + END_TIME))
        if later > _STOOD:
            return failed("it moved after its run had ended", f"{later:.2f} m", f"{_STOOD} m")
        return passed("its button stops it, and its release starts nothing")

    return judge


def latch_after_restart(estop: str) -> Judge:
    """A judge of the latch after a restart; `estop`: the step that set the latch."""

    def judge(evidence: Evidence) -> Verdict:
        status = evidence.status
        before = evidence.earlier[estop].values.get("instance")
        if status is None:
            return failed("the robot does not answer after the restart")
        if status.instance == before:
            return not_shown("the daemon was not restarted")
        if status.state is not State.ESTOPPED:
            return failed("the emergency stop was lost: look at the state folder", status.state)
        return passed("the emergency stop outlived the restart")

    return judge


def is_reset(evidence: Evidence) -> Verdict:
    """Whether the robot is idle without a latch."""
    status = evidence.status
    if status is None or status.state is State.ESTOPPED or status.latches:
        return failed("the emergency stop remains: swarmctl describe says why")
    return passed("it can be reset, and does not move")


def track_of(samples: Samples) -> Array:
    """(n, 3) arrival in s, and x and y in m, of each reading of odometry."""
    rows: Sequence[tuple[float, float, float]] = [
        (at, reading.pose.x, reading.pose.y) for at, reading in samples.odometry
    ]
    return np.array(rows, np.float64).reshape(-1, 3)


def way_of(samples: Samples) -> float:
    """The way in m from the first to the last reading of odometry, straight."""
    track = track_of(samples)
    return math.hypot(*(track[-1, 1:3] - track[0, 1:3])) if len(track) else 0.0


def _rest_after(evidence: Evidence, event: float, within: float) -> Verdict:
    """The verdict on the rest after `event` s, which must come `within` s and the braking."""
    track = track_of(evidence.samples)
    if evidence.platform.is_drone:
        track = track[track[:, 0] <= event + within + _HOVER_TIME]
    times = track[:, 0]
    ways = _ways(track)
    stop = stop_of(times, ways, event) if len(track) else None
    if stop is None or stop.speed < _LEAST_CRUISE:
        causes = "motors off, a dead zone of the base, or a drone that did not take off"
        return failed(f"it did not drive before its stop: {causes}")
    speed = stop.speed
    bound = within + speed / _braking(evidence.platform)
    seconds = float(times[np.flatnonzero(_is_moving(track, evidence.platform))[-1]]) - event
    way = stop.seconds * speed
    values = {"seconds": seconds, "way": way, "speed": speed}
    figure = f"{max(seconds, 0.0):.2f} s, {way:.2f} m"
    if _speed_at_end(times, ways) > _GOES_ON * speed:
        return failed("the base ignores zero: it drives on", figure, f"{bound:.2f} s", **values)
    if seconds > bound:
        return failed(_late_cause(stop, seconds, within), figure, f"{bound:.2f} s", **values)
    return passed(f"at rest from {speed:.2f} m/s", figure, f"{bound:.2f} s", **values)


def _is_moving(track: Array, platform: Platform) -> Array:
    """(n,) bool: whether the base still moves at each row; a drone that drifts does not."""
    times = track[:, 0]
    ways = _ways(track)
    if not platform.is_drone:
        return np.asarray(ways[-1] - ways > _AT_REST)
    near = np.interp(times[:, None] + (-_DRIFT_TIME, _DRIFT_TIME), times, np.arange(len(times)))
    rows = np.rint(near).astype(int)
    seconds, x, y = (track[rows[:, 1]] - track[rows[:, 0]]).T
    return np.asarray(np.hypot(x, y) > HOVER_DRIFT * seconds)


def _late_cause(stop: Braking, seconds: float, within: float) -> str:
    """Why a rest came late: a base that coasts slows down all the time, a late one at its end."""
    if stop.seconds > 0.75 * seconds:
        return "the base stops late: look at the delay of its commands"
    return f"the base coasts: it brakes with {stop.speed / max(seconds - within, 0.1):.2f} m/s2"


def _speed_at_end(times: Array, ways: Array) -> float:
    recent = float(times[-1]) - CRUISE
    return (float(ways[-1]) - float(np.interp(recent, times, ways))) / CRUISE


def _ways(track: Array) -> Array:
    """(n,) m along the path since the first row."""
    steps = np.hypot(*np.diff(track[:, 1:3], axis=0).T)
    return np.concatenate(([0.0], np.cumsum(steps)))


def _braking(platform: Platform) -> float:
    """The declared deceleration in m/s2; 0.5 for a platform without one."""
    return float((platform.protection.get("barrier") or {}).get("braking_linear", 0.5))
