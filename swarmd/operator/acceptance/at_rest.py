"""Part A: what a robot that rests shows of itself, its topics, its lidar and its network."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from swarmd.core.events import ReadingsInput
from swarmd.core.finding import Finding
from swarmd.core.messages import Reason
from swarmd.core.values import Array
from swarmd.operator.acceptance.evidence import Evidence, Samples
from swarmd.operator.acceptance.step import Judge
from swarmd.operator.acceptance.verdict import Result, Verdict, failed, not_shown, passed
from swarmd.operator.texts.doctor import STEPS
from swarmd.robot.protection.footprint import Footprint
from swarmd.robot.sensing.scan_content import ScanContent
from swarmd.robot.sensing.scan_delay_finding import scan_delay_finding

LOOK_TIME = 2.0
"""Seconds of a step with a hand, before the hand comes."""
_LEAST_SCANS = 10
_SLOW_SHARE = 0.9  # of the declared rate
_OFTEN_SHARE = 1.5  # of the declared rate; a lidar of 5 Hz turns by at most 7 Hz
_LEAST_APART = 0.05  # m (median of the rays) by which the scans of two sensors differ, and
_APART_SHARE = 3.0  # so many times more than two scans of one of them
_LOST_SHARE = 0.02  # of the scans; 5 % of lost datagrams are usual on a poor WiFi
# s: docs/safety.md, assumption 7
_LATEST_ODOMETRY = 0.15
_STALE_ODOMETRY = 0.5
_STALE_SHARE = 0.1  # of the time in which the newest odometry may be older
# m, rad, in a minute at rest
_DRIFT = 0.01
_TURN_DRIFT = math.radians(2.0)
_CLOCK_ERROR = 0.5  # s between two clocks that should agree
_DAY = 86400.0  # s: two clocks farther apart have another zero, which is no fault
_LOAD = "load"
_SAME_CHARGE = 1e-5  # share
_HAND = 0.8  # m within which a hand is held
_NEARER = 0.15  # m by which a hand is nearer than what was there before
_THICKNESS = 0.1  # m of a hand: an arm is farther
_ASTRAY = math.radians(30.0)  # of a hand that is held ahead, left, behind or right


def findings_on(*subjects: str) -> Judge:
    """A judge of the findings on these subjects, or of all: a fault or a warning fails."""

    def judge(evidence: Evidence) -> Verdict:
        if evidence.status is not None and evidence.status.reason is Reason.DUPLICATE_ID:
            return failed(f"two daemons have its name: {evidence.status.detail}; stop one of them")
        found = [one for one in evidence.findings if one.subject in subjects or not subjects]
        if bad := [finding for finding in found if not finding.is_well]:
            texts = (
                f"{one.subject}: {'; '.join(filter(None, (one.text, one.remedy)))}" for one in bad
            )
            return failed("; ".join(texts), f"{len(bad)} of {len(found)}", "0 findings")
        known = [finding for finding in found if finding.is_measured]
        if not known:
            return not_shown("; ".join(one.text for one in found) or "it did not answer")
        names = ", ".join(dict.fromkeys(one.subject for one in known))
        return passed(names, f"{len(known)} ok", "0 findings")

    return judge


def findings_of(step: str) -> Judge:
    """A judge of the findings that belong to a step, by the list of all checks."""
    return findings_on(*(subject for subject, id in STEPS.items() if id == step))


def lasting(before: Sequence[Finding], after: Sequence[Finding]) -> list[Finding]:
    """The findings `after`, with a high load only if the load was high `before`, too.

    The load of a minute rises with each start of a program, such as of this test.
    """
    well = {one.subject: one for one in before if one.subject == _LOAD and one.is_well}
    return [one if one.is_well else well.get(one.subject, one) for one in after]


def base(evidence: Evidence) -> Verdict:
    """Whether the driver has the base, and nobody else drives it."""
    states = evidence.samples.driver_states
    if not states:
        return not_shown("the recording has no state of the driver")
    for state in states:
        if not state.is_up or state.hold is not None:
            hold = f" ({state.hold})" if state.hold is not None else ""
            return failed(f"{state.text}{hold}")
    return passed(states[-1].text)


def scan_rate(evidence: Evidence) -> Verdict:
    """Rate, losses and the longest gap of the scans."""
    spec = evidence.platform.scan
    scans = evidence.samples.scans
    if len(scans) < _LEAST_SCANS:
        return failed(f"scans are missing: {_driver_text(evidence)}", f"{len(scans)} scans")
    gaps = np.diff([at for at, _ in scans])
    period = float(np.median(gaps))
    mean = float(gaps.mean())
    came = f"{len(scans)} scans in {float(gaps.sum()):.1f} s"
    if _are_of_two([_distances(scan.ranges) for _, scan in scans]):
        return failed(
            "two sensors send scans in turn on one topic: give swarmd the topic of one of them",
            came,
            f"{spec.rate:g} Hz",
        )
    if period <= 0.5 * mean or mean <= 0.0:
        return failed(
            "scans come in bursts, or twice: look at the bridge and its buffers, and at the power"
            " saving of the WiFi",
            came,
            f"{spec.rate:g} Hz",
        )
    rate = 1.0 / period
    if mean * _OFTEN_SHARE * spec.rate < 1.0:
        return failed(
            "scans come too often: two nodes publish them; or correct scan.rate",
            came,
            f"{_OFTEN_SHARE * spec.rate:g} Hz",
        )
    lost = int(np.maximum(np.rint(gaps / period) - 1.0, 0.0).sum())
    share = lost / (len(scans) + lost)
    longest = float(gaps.max())
    values = {"rate": rate, "lost": share, "longest": longest}
    if rate < _SLOW_SHARE * spec.rate:
        reason = "scans come too rarely: look at the lidar and the load; or correct scan.rate"
        return failed(reason, f"{rate:.1f} Hz", f"{_SLOW_SHARE * spec.rate:.1f} Hz", **values)
    if share > _LOST_SHARE:
        reason = "scans are lost, or published late: look at the network, the load and the lidar"
        return failed(reason, f"{share:.1%} lost", f"{_LOST_SHARE:.0%}", **values)
    if longest > spec.stale_after:
        reason = "scans paused: the robot would have been held"
        return failed(reason, f"{longest:.2f} s", f"{spec.stale_after:.2f} s", **values)
    figure = f"{rate:.1f} Hz, {share:.1%} lost"
    bound = f"{_SLOW_SHARE * spec.rate:.1f} Hz, {_LOST_SHARE:.0%}"
    return passed(f"the longest gap is {longest:.2f} s", figure, bound, **values)


def stamps(evidence: Evidence) -> Verdict:
    """Whether scans and odometry are stamped by one clock, and whether it is the wall clock."""
    spec = evidence.platform.scan
    samples = evidence.samples
    scans = [(at, scan.stamp) for at, scan in samples.scans]
    odometry = [(at, reading.stamp) for at, reading in samples.odometry]
    if len(scans) < _LEAST_SCANS or len(odometry) < _LEAST_SCANS:
        return not_shown("too few scans or odometry")
    for name, pairs in (("scans", scans), ("odometry", odometry)):
        steps = np.diff([stamp for _, stamp in pairs])
        if not np.isfinite(steps).all():
            return failed(f"the stamps of {name} are no numbers: look at the clock of its node")
        if steps.min() < 0.0:
            return failed(f"the stamps of {name} went back: a clock was set, or two nodes publish")
        if steps.max() <= 0.0:
            return failed(f"the stamps of {name} stand still: look at the clock of its node")
    scan_lag = _least_lag(scans)
    odometry_lag = _least_lag(odometry)
    apart = scan_lag - odometry_lag
    if _CLOCK_ERROR < abs(apart) < _DAY:
        which = "older" if apart > 0.0 else "newer"
        reason = f"the stamps of scans are {which} than those of odometry: two clocks differ"
        return failed(reason, f"{abs(apart):.2f} s", f"{_CLOCK_ERROR} s", apart=apart)
    off_wall = odometry_lag + samples.wall
    if _CLOCK_ERROR < abs(off_wall) < _DAY:
        reason = "stamps and the clock of the computer differ: synchronise the clocks"
        return failed(reason, f"{abs(off_wall):.2f} s", f"{_CLOCK_ERROR} s")
    finding = scan_delay_finding(scans, odometry, samples.scans[-1][1], spec)
    if not finding.is_measured:
        return not_shown(finding.text)
    return passed(finding.text) if finding.is_well else failed(finding.text)


def lidar(evidence: Evidence) -> Verdict:
    """What `--check` says of the content of scans: own body, blind sectors, zeros, repeats."""
    platform = evidence.platform
    content = ScanContent(platform.scan, gaps=Footprint(platform.footprint).gaps)
    for _, scan in evidence.samples.scans:
        content.take(scan)
    if content.count < _LEAST_SCANS or content.last is None:
        return not_shown("too few scans")
    if not len(content.last.ranges):
        return failed("the scans have no rays: look at the lidar and its topic")
    return failed(content.fault) if content.fault else passed(content.text)


def hand(wanted: float, ahead: str = "") -> Judge:
    """A judge of the bearing at which a hand is seen that is held at `wanted` degrees.

    `ahead`: the step with the hand ahead; empty for this step itself.
    """

    def judge(evidence: Evidence) -> Verdict:
        seen = _hand_bearing(evidence.samples)
        if seen is None:
            why = f"no hand was seen within {_HAND} m: the lidar is blind there, or the hand"
            return failed(f"{why} was above or below its plane", bound=f"{wanted:.0f} deg")
        degrees = math.degrees(seen)
        figure = f"{degrees:.0f} deg"
        bound = f"{wanted:.0f} +- {math.degrees(_ASTRAY):.0f} deg"
        if _is_near(seen, math.radians(wanted)):
            return passed("the hand is where the scan shows it", figure, bound, bearing=degrees)
        earlier = evidence.earlier.get(ahead)
        is_ahead_right = earlier is not None and earlier.result is Result.PASS
        if is_ahead_right and _is_near(seen, math.radians(-wanted)):
            cause = "the scan is mirrored: set scan_upside_down, or swap the left and right sensor"
        else:
            turned = math.degrees(math.remainder(seen - math.radians(wanted), math.tau))
            cause = f"the scan is turned by {turned:.0f} deg: correct scan_yaw_deg"
        return failed(cause, figure, bound, bearing=degrees)

    return judge


def odometry_at_rest(evidence: Evidence) -> Verdict:
    """Gaps of odometry, and its drift at rest."""
    readings = evidence.samples.odometry
    if len(readings) < _LEAST_SCANS:
        return failed(f"odometry is missing: {_driver_text(evidence)}", f"{len(readings)} readings")
    # By distinct stamps: a repeated reading is not new.
    gaps = np.diff(np.unique([reading.stamp for _, reading in readings]))
    if not gaps.sum() > 0.0:
        return failed(
            "the base repeats one reading: look at its odometry", f"{len(readings)} readings"
        )
    period = float(np.median(gaps))
    longest = float(gaps.max())
    pauses = np.diff([at for at, _ in readings])
    stale = float(np.maximum(pauses - _LATEST_ODOMETRY, 0.0).sum() / max(pauses.sum(), 1e-9))
    if stale > _STALE_SHARE and period <= _LATEST_ODOMETRY:
        return failed(
            "odometry comes in bursts: look at the bridge and its buffers, and at the power saving"
            " of the WiFi",
            f"{stale:.0%} of the time late",
            f"{_STALE_SHARE:.0%}",
            longest=pauses.max(),
        )
    if period > _LATEST_ODOMETRY or longest > _STALE_ODOMETRY:
        figure = f"{period:.2f} s, at most {longest:.2f} s"
        bound = f"{_LATEST_ODOMETRY} s, at most {_STALE_ODOMETRY} s"
        return failed("odometry comes too rarely, or pauses", figure, bound)
    first = readings[0][1].pose
    ways = [math.hypot(one.pose.x - first.x, one.pose.y - first.y) for _, one in readings]
    turns = [abs(math.remainder(one.pose.yaw - first.yaw, math.tau)) for _, one in readings]
    drift = f"{1e3 * max(ways):.0f} mm, {math.degrees(max(turns)):.1f} deg"
    bound = f"{1e3 * _DRIFT:.0f} mm, {math.degrees(_TURN_DRIFT):.0f} deg"
    if max(ways) > _DRIFT or max(turns) > _TURN_DRIFT:
        return failed("odometry drifts at rest, or the robot was moved", drift, bound)
    return passed(f"{1.0 / period:.0f} Hz; drift at rest", drift, bound)


def battery(evidence: Evidence) -> Verdict:
    """Whether the charge of the battery is reported, if the platform has it."""
    if not {"reading:battery", "reading:height"} & evidence.platform.provides:  # as each drone
        return not_shown("its platform file names no battery: add reading:battery to provides")
    values = [one.readings.get("battery", math.nan) for _, one in _readings(evidence.samples)]
    if not values or math.isnan(values[-1]):
        return failed("no battery message comes: look at its topic and type in the driver options")
    charge = values[-1]
    if not 0.0 <= charge <= 1.0:
        reason = "the charge is no share: correct battery_volts or battery_percentage"
        return failed(reason, f"{charge:g}", "0 to 1")
    return passed("the charge is reported", f"{charge:.0%}")


def own_battery(evidence: Evidence) -> Verdict:
    """Whether the charge is this robot's: no other robot reports the same one."""
    values = [one.readings.get("battery", math.nan) for _, one in _readings(evidence.samples)]
    own = [value for value in values if not math.isnan(value)]
    if not own or not evidence.charges:
        what = "this one reports none" if not own else f"compare {own[-1]:.0%} with its display"
        return not_shown(f"two robots with a battery must be heard: {what}")
    same = [name for name, charge in evidence.charges.items() if _is_among(charge, own)]
    text = f"{own[-1]:.1%}"
    if not same:
        return passed(f"no other charge of {len(evidence.charges)} is equal", text)
    if _is_among(100.0 * own[-1], np.rint(100.0 * np.array(own)).tolist()):
        return not_shown(f"{text} is that of {same[0]} too: repeat it once their charges differ")
    return failed(f"it reports the battery of {same[0]}: correct the topic of its battery", text)


def _is_among(value: float, values: list[float]) -> bool:
    return min(abs(value - one) for one in values) < _SAME_CHARGE


def _readings(samples: Samples) -> list[tuple[float, ReadingsInput]]:
    return list(samples.of(ReadingsInput))


def _driver_text(evidence: Evidence) -> str:
    """What the driver said last."""
    states = evidence.samples.driver_states
    return states[-1].text if states else "the recording has no word of the driver"


def _least_lag(pairs: list[tuple[float, float]]) -> float:
    """s from the stamp to the arrival of the fastest: bursts do not count."""
    return min(at - stamp for at, stamp in pairs)


def _are_of_two(scans: list[Array]) -> bool:
    """True if each scan differs from the next one, and is like the one after that.

    `scans`: distances (n,) in m of a robot at rest.
    """
    after, next_but_one = (
        float(np.median([_apart(*pair) for pair in zip(scans, scans[step:], strict=False)]))
        for step in (1, 2)
    )
    return after > _LEAST_APART + _APART_SHARE * next_but_one


def _apart(scan: Array, other: Array) -> float:
    """The median difference of the rays of two scans in m; infinite if their numbers differ."""
    if len(scan) != len(other):
        return math.inf
    return float(np.median(np.abs(scan - other))) if len(scan) else 0.0


def _is_near(bearing: float, other: float) -> bool:
    return abs(math.remainder(bearing - other, math.tau)) <= _ASTRAY


def _hand_bearing(samples: Samples) -> float | None:
    """The bearing in rad of the nearest return that came after LOOK_TIME; None without one."""
    scans = samples.scans
    if not scans:
        return None
    begin = scans[0][0]
    count = len(scans[0][1].ranges)
    same = [(at, scan) for at, scan in scans if len(scan.ranges) == count]
    before = [_distances(scan.ranges) for at, scan in same if at - begin < LOOK_TIME]
    background = np.median(before, axis=0)
    best = _HAND
    bearing = None
    for at, scan in same:
        distances = _distances(scan.ranges)
        is_new = distances < background - _NEARER
        nearest = float(distances[is_new].min(initial=math.inf))
        if at - begin >= LOOK_TIME and nearest < best:
            rays = scan.bearings[is_new & (distances <= nearest + _THICKNESS)]
            best = nearest
            bearing = math.atan2(float(np.sin(rays).sum()), float(np.cos(rays).sum()))
    return bearing


def _distances(ranges: Array) -> Array:
    """(n,) m; infinite without a measured return. Large finite numbers have a median."""
    return np.where(np.isfinite(ranges) & (ranges > 0.0), ranges, 1e3)
