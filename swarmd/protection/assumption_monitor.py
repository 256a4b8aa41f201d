"""Compares the assumptions of mode `barrier` about base and surroundings with measurements. Pure.

Braking of the base:
- A stop begins when the safe command falls clearly. The stop ends when odometry shows that the base
  has followed the command, or when the command rises.
- A model of a base that responds after a delay and brakes evenly is fitted to the distances of all
  periods of odometry, from shortly before the stop. Delay and speed of the base are free, so
  neither late nor rare odometry makes brakes look weak. The residuals of the fits estimate the
  noise of odometry. A stop weighs by the likelihood of its readings.
- The test is CUSUM (Page, Biometrika 1954): it sums from stop to stop the logarithm of the
  likelihood ratio of two hypotheses, and never falls below zero. The hypotheses are brakes with the
  share WEAK, and with the share SOUND, of the declared braking. Brakes of at least SOUND raise an
  alarm after e^ALARM stops on average, or later (Lorden, Annals of Mathematical Statistics 1971).
  An alarm needs at least three stops, since another robot may have pushed this robot in one.
- A base that moves sideways has the same declared braking ahead and sideways. Its wheels may share
  their braking between both axes in a diagonal stop. So a stop counts only if the speed on the
  other of these axes changes little.

Speed of others: the speed at which the gap to the nearest return falls is fitted by least squares
over several scans. All motion of the robot itself and the standard deviations are subtracted. The
rest is compared with `others_speed`. An object that approaches is found, an object that passes is
not.

A violation reduces the speed of the robot to `speed_share` until an operator ends the violation,
since nothing that happens later proves the assumption again. For braking, the share is the measured
braking (less two standard deviations) over the declared braking: with it the time to stop is as
declared, and the distance to stop is shorter. For others, the share is the assumed speed over the
measured speed.

A kernel (see `core/kernels.py`), since each reading of odometry and each command pass it.
"""

from __future__ import annotations

import math
from collections import deque
from operator import itemgetter
from typing import TYPE_CHECKING

import msgspec
import numpy as np

from swarmd.core.values import MAX_SPEED, MAX_STEP, ZERO, Odometry, Platform, Twist
from swarmd.protection.settings import BarrierSettings

if TYPE_CHECKING:  # Cython reads this import, CPython the other
    from collections.abc import Collection

    import cython

else:
    from swarmd.core import cython_shadow as cython
if cython.compiled:
    from cython.cimports.libc.math import copysign, cos, fabs, remainder, sin, sqrt
else:
    from swarmd.core.cython_shadow import copysign, cos, fabs, remainder, sin, sqrt

MIN_SHARE = 0.2
"""The lowest `speed_share`."""
SOUND, WEAK = 0.85, 0.7
"""Shares of the declared braking between which the test distinguishes."""
ALARM = 14.0
"""The sum of the test at which it alarms: sound brakes do so once in a million stops (e^14)."""

_MOST_OF_ONE = 5.0  # the most that one stop adds to the sum: an alarm needs three stops
_SHARES = np.array((*np.geomspace(0.15, 0.63, 11), WEAK, 0.77, SOUND, 0.92, 1.0, 1.1))
_WEAK, _SOUND = (int(np.flatnonzero(share == _SHARES)[0]) for share in (WEAK, SOUND))
_LONGEST_DELAY = 0.6  # s from the command to the stamp at which the base responds
_DELAYS = np.linspace(0.0, _LONGEST_DELAY, 13)
_NEAR_DELAYS = np.linspace(-0.04, 0.04, 9)
_PARTS = np.array((0.25, 0.75))  # of each period: the mean of the speeds there gives its distance
# Noise of odometry as a share of a reading before any stop, and how many readings it counts for.
_SLIP, _SLIP_FREEDOM = 0.05, 20.0
_MAX_FREEDOM = 400.0  # readings that count for the noise at most, so that older ones fade
_WORST = 9.0  # times the variance: the most that one stop may add to the estimate of the variance
# Share of the speed before a stop: a slower reading has the noise of that speed.
_STILL = 0.2

_MIN_DROP = 0.08, 0.4  # m/s and rad/s by which the command must fall at once
_MIN_DROP_TIME = 0.1  # s that the fall takes at the declared braking, at least
# Share of the speed: noise of odometry grows with the speed.
_MIN_DROP_SHARE = cython.declare(cython.double, 0.5)
# Share of the command by which the speed may differ from the command before a stop.
_FOLLOWED = cython.declare(cython.double, 0.15)
# Readings before a stop that give its speed: the most and the least.
_CRUISE = cython.declare(cython.Py_ssize_t, 6)
_MIN_CRUISE = cython.declare(cython.Py_ssize_t, 2)
_MIN_STEPS = 3  # readings of a stop
_ENDS = cython.declare(cython.double, 0.1)  # share of the fall that remains when a stop ends
# Share of the speed by which noise may raise the speed during a stop.
_RISE = cython.declare(cython.double, 0.3)
_MAX_WAIT = cython.declare(cython.double, 1.5)  # s in which a stop is judged
_MAX_PERIOD = cython.declare(cython.double, 0.3)  # s between two readings
# Share of the command before a stop by which the command may rise again.
_RISES = cython.declare(cython.double, 0.2)
# Share of the fall of a stop by which the speed on the other axis may change: brakes that both
# axes share then leave 0.96 of the braking for the stop.
_BESIDE = cython.declare(cython.double, 0.3)
_MAX_COMMANDS = cython.declare(cython.Py_ssize_t, 40)
_MAX_WAYS = cython.declare(cython.Py_ssize_t, 64)

_NEAR = cython.declare(cython.double, 1.5)  # m within which an approach counts
_APPROACH, _MIN_APPROACH = 0.85, 0.35  # s of scans from which a speed is measured: most and least
_MIN_SCANS = 4  # in that time: a lidar of 5 Hz sees a pedestrian in no more
_MAX_GAP_TIME = cython.declare(cython.double, 0.6)  # s between two scans of one approach
_FASTER = 1.15  # times others_speed: an approach that is clearly faster
_RANGE_NOISE = 0.01  # m of the nearest range, at least
# m, plus a share of the distance, by which a scan may differ from an even approach: if an object
# appears or is lost, the nearest return jumps.
_STEADY, _STEADY_SHARE = 0.03, 0.05
_CERTAIN = 3.0  # standard deviations by which an approach must be too fast
_APART, _TOGETHER = 5.0, 600.0  # s between two approaches that together are a violation

RESPONSE = 0.05
"""s after a command within which the base responds, as mode `barrier` assumes."""
_RESPONSES = 9  # the last stops: the base is late if it responded late in all but one
_LATER = 0.05  # s beyond RESPONSE that are late: a reading shows a command up to a period late

_BRAKED = "braked at"
_LATE_WHY = "commands, base or odometry are slow"
_UNITS = "m/s2", "rad/s2", "m/s2 sideways"

_turn = cython.declare(cython.double, math.tau)
_max_step = cython.declare(cython.double, MAX_STEP)
_max_speed = cython.declare(cython.double, MAX_SPEED)
_inf = cython.declare(cython.double, math.inf)


def _last(count: int, most: int) -> range:
    """The indices of the last `most` of `count` items."""
    return range(max(count - most, 0), count)


def axis_of(finding: str) -> str | None:
    """`linear`, `angular` or `lateral` for a finding about brakes; None for one about others."""
    if not finding.startswith(_BRAKED):
        return None
    if _UNITS[2] in finding:
        return "lateral"
    return "angular" if _UNITS[1] in finding else "linear"


@cython.final
@cython.cclass
class _Stop:
    """A fall of the command of one axis, and the motion by odometry before and after.

    Speeds are relative to `sign`, so they are positive before the stop.
    """

    sign: cython.double  # 1 or -1: the direction of the motion before the stop
    begin: cython.double  # speed commanded before the stop
    least: cython.double  # lowest speed commanded since
    at: cython.double  # stamp of odometry at which the command fell
    # Periods of odometry before and after the fall: stamp at begin, stamp at end, m or rad moved.
    cruise: list
    steps: list

    def __init__(self, sign: float, begin: float, least: float, at: float, cruise: list):
        self.sign, self.begin, self.least, self.at = sign, begin, least, at
        self.cruise, self.steps = cruise, []


@cython.final
@cython.cclass
class _Brake:
    """Judges the stops of one axis (ahead, turning or sideways)."""

    declared: cython.double  # m/s2 or rad/s2, the declared braking
    braking: cython.double  # m/s2 or rad/s2, as declared, or measured and weaker
    evidence: object  # text on how the weaker braking was measured; empty without a violation
    late: object  # text on how late the base responds; empty if it is not too late
    _unit: object
    _delays: object
    _min_drop: cython.double  # m/s or rad/s, the least fall of the command that begins a stop
    _stop: _Stop  # the stop under way; None without one
    _command: cython.double  # the last command
    # Ring buffers (item k is at k modulo the length). The commands: how many were given, the stamp
    # since which each holds, its speed.
    _given: cython.Py_ssize_t
    _stamps: cython.double[40]
    _levels: cython.double[40]
    # The periods of odometry in which the base followed a constant command: how many, and of each
    # the stamp at begin, the stamp at end, and m or rad moved.
    _cruised: cython.Py_ssize_t
    _cruise: cython.double[18]
    _variance: cython.double  # of the noise of odometry, as a share of a reading
    _freedom: cython.double  # degrees of freedom of this estimate
    # The CUSUM test: the sum, the stops since it was zero, and the summed misfits by share.
    _sum: cython.double
    _stops: cython.Py_ssize_t
    _misfits: object

    def __init__(self, declared: float, min_drop: float, unit: str) -> None:
        self.declared, self._unit = declared, unit
        self._min_drop = max(min_drop, _MIN_DROP_TIME * declared)
        self.interrupt()
        self._variance, self._freedom = _SLIP**2, _SLIP_FREEDOM  # of a reading, as a share of it
        self._delays, self.late = deque(maxlen=_RESPONSES), ""
        self.forget()

    def check_indices(self) -> None:
        """ValueError unless its counts are of its arrays; see `recall`."""
        if not (0 <= self._given < 1 << 60 and 0 <= self._cruised < 1 << 60):
            raise ValueError(f"{self._given} commands and {self._cruised} steps of a brake")

    def forget(self) -> None:
        """Trust the declared braking again, and begin the test anew."""
        self.braking, self.evidence = self.declared, ""
        self._begin()

    def interrupt(self) -> None:
        """Drop the stop under way, as after a jump of the clock or the pose of odometry."""
        self._stop = None
        self._cruised = self._given = 0
        self._note(-math.inf, self._command)

    @cython.ccall
    def share_with(self, axis: _Brake, speed: cython.double, stamp: cython.double):
        """Drop the stop under way if the speed on another `axis` changes, too.

        `speed` is the last measured speed on that axis, at `stamp`. It may follow any command of
        the last _LONGEST_DELAY s, so all these commands are compared.
        """
        stop: _Stop = self._stop
        if stop is None:
            return
        change: cython.double = fabs(axis._command - speed)
        k: cython.Py_ssize_t
        for k in range(axis._given - 1, max(axis._given - _MAX_COMMANDS, 0) - 1, -1):
            change = max(change, fabs(axis._command - axis._levels[k % _MAX_COMMANDS]))
            if axis._stamps[k % _MAX_COMMANDS] <= stamp - _LONGEST_DELAY:
                break
        if change > _BESIDE * (stop.begin - stop.least):
            self._stop = None

    @cython.cfunc
    def _note(self, stamp: cython.double, command: cython.double):
        """Keep a command."""
        at: cython.Py_ssize_t = self._given % _MAX_COMMANDS
        self._stamps[at], self._levels[at] = stamp, command
        self._given += 1

    def _begin(self) -> None:
        self._sum, self._stops = 0.0, 0
        self._misfits = np.zeros(len(_SHARES))

    @cython.ccall
    def on_command(
        self, command: cython.double, speed: cython.double, stamp: cython.double
    ) -> cython.bint:
        """Take in a command; `speed` is the last measured speed, at `stamp`. True: a violation.

        A command that falls clearly begins a stop, if the base moved as commanded before. A command
        that rises ends the stop under way, which is then judged.
        """
        before: cython.double = self._command
        level: cython.double
        if command == before:
            return False
        self._command = command
        self._note(stamp, command)
        stop: _Stop = self._stop
        if stop is not None:
            level = max(stop.sign * command, 0.0)
            stop.least = min(level, stop.least)
            return level > stop.least + _RISES * stop.begin and self._end()
        if (before - command if before > 0.0 else command - before) < self._min_drop:
            return False
        begin: cython.double = fabs(before)
        sign: cython.double = copysign(1.0, before)
        level = max(sign * command, 0.0)
        if begin - level < self._min_drop or begin - level < _MIN_DROP_SHARE * begin:
            return False
        if fabs(speed - before) <= _FOLLOWED * begin and self._cruised >= _MIN_CRUISE:
            rows = [3 * (k % _CRUISE) for k in _last(self._cruised, _CRUISE)]
            cruise = [(self._cruise[k], self._cruise[k + 1], self._cruise[k + 2]) for k in rows]
            self._stop = _Stop(sign, begin, level, stamp, cruise)
        self._cruised = 0
        return False

    @cython.ccall
    def on_step(self, begin: cython.double, end: cython.double, way: cython.double) -> cython.bint:
        """Take in the m or rad `way` that the base moved between two stamps. True: a violation.

        Without a stop under way, collects the periods in which the base follows the command.
        During a stop, collects its periods, and judges the stop once it is over.
        """
        stop: _Stop = self._stop
        period: cython.double = end - begin
        if stop is None:
            wanted: cython.double = self._command * period
            if wanted == 0.0 or fabs(way - wanted) > _FOLLOWED * fabs(wanted):
                self._cruised = 0
            else:
                at: cython.Py_ssize_t = 3 * (self._cruised % _CRUISE)
                self._cruise[at], self._cruise[at + 1], self._cruise[at + 2] = begin, end, way
                self._cruised += 1
            return False
        stop.steps.append((begin, end, way))
        speed: cython.double = stop.sign * way / period
        if speed > (1.0 + _RISE) * stop.begin or period > _MAX_PERIOD:
            self._stop = None  # another robot pushed it, or odometry was lost
            return False
        is_done: cython.bint = speed - stop.least <= _ENDS * (stop.begin - stop.least)
        return (is_done or end - stop.at > _MAX_WAIT) and self._end()

    @cython.cfunc
    def _end(self) -> cython.bint:
        """End the stop and judge it: update noise and test. True: a violation."""
        stop: _Stop = self._stop
        self._stop = None
        self._cruised = 0
        if len(stop.steps) < _MIN_STEPS:
            return False
        kept = [k % _MAX_COMMANDS for k in _last(self._given, _MAX_COMMANDS)]
        commands = [(self._stamps[k], self._levels[k]) for k in kept]
        misfits, freedom, delay = _misfits(stop, commands, self.braking)
        self._respond(delay, (stop.steps[len(stop.steps) - 1][1] - stop.at) / len(stop.steps))
        # Pool the variance of the best fit with the estimate so far.
        least = float(misfits.min())
        own_variance = least / freedom
        bounded = min(own_variance, _WORST * self._variance)
        total = self._variance * self._freedom + bounded * freedom
        self._freedom += freedom
        self._variance = total / self._freedom
        self._freedom = min(self._freedom, _MAX_FREEDOM)
        # Add the logarithm of the likelihood ratio of WEAK and SOUND.
        misfits = (misfits - least) / max(self._variance, own_variance)
        gained = 0.5 * float(misfits[_SOUND] - misfits[_WEAK])
        self._sum += min(gained, _MOST_OF_ONE)
        if self._sum <= 0.0:
            self._begin()
            return False
        self._stops += 1
        self._misfits += misfits
        return self._sum >= ALARM and self._conclude()

    def _respond(self, delay: float, period: float) -> None:
        """Note the `delay` in s of the response in a stop, and set `late`.

        A reading shows a command up to `period` s late, the time between two readings.
        """
        delays = self._delays
        delays.append(delay - period)
        is_late = len(delays) == _RESPONSES and sorted(delays)[1] > RESPONSE + _LATER
        self.late = ""
        if is_late:
            self.late = (
                f"the base responds {sorted(delays)[_RESPONSES // 2]:.2f} s or more after commands"
                f" ({self._unit}, {_RESPONSES} stops), assumed are {RESPONSE:.2f} s: {_LATE_WHY}"
            )

    def _conclude(self) -> bool:
        """Set `braking` and `evidence` by the stops of the test; always True.

        The measured braking is the minimum of a parabola through the misfits of three neighbouring
        shares. The curvature of the parabola gives the standard deviation.
        """
        best = int(self._misfits.argmin())
        slowness = 1.0 / _SHARES
        i = min(max(best, 1), len(_SHARES) - 2)
        near = slice(i - 1, i + 2)
        a, b, _ = np.polyfit(slowness[near], self._misfits[near], 2)
        middle = float(-0.5 * b / a) if a > 0.0 else float(slowness[best])
        middle = min(max(middle, float(slowness[near].min())), float(slowness[near].max()))
        deviation = 1.0 / math.sqrt(max(float(a), 1e-6))
        before, stops = self.braking, self._stops
        measured = before / middle
        spread = measured * deviation / middle
        self._begin()
        self.braking = min(max(measured - 2.0 * spread, MIN_SHARE * measured), before)
        unit = self._unit
        self.evidence = (
            f"{_BRAKED} {measured:.2f} +- {spread:.2f} {unit} in {stops} stops, declared"
            f" {self.declared:.2f}"
        )
        return True


def _misfits(stop: _Stop, commands: list, declared: float):
    """Fit a base to the readings of a stop, for each share of the declared braking.

    The base rises with its command at once, and brakes evenly. Delay and scale of its speeds are
    free. `commands` are (stamp, speed) pairs.

    Returns:
        (s,) sums of squared residuals, each relative to the squared distance of its period.
        The degrees of freedom.
        The delay in s of the share that fits best.
    """
    rows = np.array((*stop.cruise, *stop.steps))
    periods, ways = rows[:, 1] - rows[:, 0], stop.sign * rows[:, 2]
    first = rows[0, 0] - _LONGEST_DELAY
    last = len(commands) - 1
    kept = [
        command
        for k, command in enumerate(commands[:last])
        if first < commands[k + 1][0] != command[0]
    ]
    stamps, levels = np.array((*kept, commands[last])).T
    levels = np.maximum(stop.sign * levels, 0.0)
    count = len(stop.cruise)
    seen = float(ways[:count].sum() / periods[:count].sum())
    weights = 1.0 / (ways**2 + (_STILL * seen * periods) ** 2)
    table = _view(np.stack((rows[:, 0], periods, weights * ways, weights), axis=1))
    stamps = _view(np.concatenate(([-np.inf], stamps)))
    levels = _view(np.concatenate(([0.0], levels)))
    rates = _view(_SHARES * declared * stop.begin / seen)  # in units of the command
    left, delays = np.asarray(_left(table, stamps, levels, rates, float(weights @ ways**2)))
    return left, max(len(ways) - 3.0, 1.0), float(delays[left.argmin()])


def _view(values):
    """`values` (n,) or (n, m) as the kernel reads them: in CPython as numbers of Python."""
    if not cython.compiled:
        return memoryview(values) if values.ndim > 1 else values.tolist()
    return values


@cython.cfunc
def _left(
    rows: cython.double[:, ::1],
    stamps: cython.double[::1],
    levels: cython.double[::1],
    rates: cython.double[::1],
    total: cython.double,
):
    """(2, s) the weighted sums of squared residuals for each braking of `rates` (s,), and delays.

    The delay is the best of a coarse grid, then of a fine grid around the best coarse delay.

    Args:
        rows: (n, 4), of each period: begin, duration, weight times distance, weight.
        stamps: since when each command holds.
        levels: the speed of each command.
        rates: braking in units of the command.
        total: the weighted sum of the squared distances.
    """
    i: cython.Py_ssize_t
    j: cython.Py_ssize_t
    k: cython.Py_ssize_t
    at: cython.Py_ssize_t
    part: cython.Py_ssize_t
    count: cython.Py_ssize_t = len(stamps)
    delays: cython.double[::1] = _view(_DELAYS)
    near: cython.double[::1] = _view(_NEAR_DELAYS)
    parts: cython.double[::1] = _view(_PARTS)
    # The speed at the stamp of each command, of a base that brakes from the commands before.
    before: cython.double[::1] = _view(np.zeros(count))
    least: cython.double[:, ::1] = _view(np.zeros((2, len(rates))))
    for j in range(len(rates)):
        rate: cython.double = rates[j]
        for k in range(2, count):
            fallen: cython.double = before[k - 1] - rate * (stamps[k] - stamps[k - 1])
            before[k] = max(levels[k - 1], fallen)
        best: cython.double = 0.0
        least[0, j] = _inf
        for k in range(len(delays) + len(near)):
            if k == len(delays):
                rough: cython.double = best
                least[0, j] = _inf
            delay: cython.double = delays[k] if k < len(delays) else rough + near[k - len(delays)]
            both: cython.double = 0.0
            own: cython.double = 0.0
            at = 0
            for i in range(len(rows)):
                speed: cython.double = 0.0
                for part in range(2):  # the mean of two parts
                    since: cython.double = rows[i, 0] + parts[part] * rows[i, 1] - delay
                    while at + 1 < count and stamps[at + 1] <= since:
                        at += 1
                    while stamps[at] > since:
                        at -= 1
                    speed += max(levels[at], before[at] - rate * (since - stamps[at]))
                modelled: cython.double = 0.5 * speed * rows[i, 1]
                both += modelled * rows[i, 2]
                own += modelled * modelled * rows[i, 3]
            # The scale of least squares: odometry and base may be off by a few percent.
            left: cython.double = total - both * both / max(own, 1e-12)
            if left < least[0, j]:
                least[0, j], best = left, delay
        least[1, j] = best
    return least


@cython.final
@cython.cclass
class AssumptionMonitor:
    """Watches braking and the speed of others for one robot.

    The methods that take inputs return the text of an event for the robot's log, or an empty text.
    `speed_share` in [MIN_SHARE, 1] is the share of the safe command that the base may get.
    """

    speed_share = cython.declare(cython.double, visibility="readonly")
    _settings: object
    _radius: cython.double
    _linear: _Brake
    _angular: _Brake
    _lateral: _Brake  # None: the base cannot move sideways
    _command: object
    # The last reading: its stamp, pose and speeds.
    _stamp: cython.double
    _x: cython.double
    _y: cython.double
    _yaw: cython.double
    _speed: cython.double
    _rate: cython.double
    _aside: cython.double
    _moved: cython.double  # m that any corner may have moved so far
    # A ring buffer of the last stamps of odometry, and of `_moved` at each. Item k is at k modulo
    # the length; items from `_way_first` to before `_way_end` are in use.
    _way_at: cython.double[64]
    _way: cython.double[64]
    _way_first: cython.Py_ssize_t
    _way_end: cython.Py_ssize_t
    # The last scans: stamp, gap, `_moved` when the oldest ray was measured, `_moved` on arrival.
    _scans: object
    _others: object  # text on others that are too fast; empty without a violation
    _others_share: cython.double  # of `speed_share`
    _approaches: object  # the approaches that were too fast: stamp, m/s, standard deviation

    def __init__(self, platform: Platform) -> None:
        settings = msgspec.convert(platform.protection["barrier"], BarrierSettings)
        self._settings = settings
        self._radius = float(np.hypot(*platform.footprint.T).max())
        self._linear = _Brake(settings.braking_linear, _MIN_DROP[0], _UNITS[0])
        self._angular = _Brake(settings.braking_angular, _MIN_DROP[1], _UNITS[1])
        is_lateral = platform.limits.lateral > 0.0
        sideways = _Brake(settings.braking_linear, _MIN_DROP[0], _UNITS[2]) if is_lateral else None
        self._lateral = sideways
        self._command, self._stamp = ZERO, -math.inf
        self._scans, self._approaches = deque(maxlen=64), deque()
        self._others, self._others_share, self.speed_share = "", 1.0, 1.0

    def check_indices(self) -> None:
        """ValueError unless its counts are of its arrays; see `recall`."""
        if not (0 <= self._way_first < 1 << 60 and 0 <= self._way_end < 1 << 60):
            raise ValueError(f"ways from {self._way_first} to {self._way_end}")

    @property
    def findings(self) -> tuple[str, ...]:
        """The violated assumptions, each with its evidence."""
        brake: _Brake
        evidence = []
        for brake in self._brakes():
            evidence.append(brake.evidence)
        return tuple(text for text in (*evidence, self._others) if text)

    @property
    def late(self) -> str:
        """How late the base responds to its commands; empty if it is as fast as assumed."""
        brake: _Brake
        for brake in self._brakes():
            if brake.late:
                return str(brake.late)
        return ""

    def _brakes(self) -> tuple[_Brake, ...]:
        """The brakes of all axes on which the base moves."""
        both = self._linear, self._angular
        return both if self._lateral is None else (*both, self._lateral)

    def forget(self, findings: Collection[str]) -> None:
        """End these findings: the declared values count again, and are watched anew."""
        brake: _Brake
        for brake in self._brakes():
            if brake.evidence in findings:
                brake.forget()
        if self._others in findings:
            self._others, self._others_share = "", 1.0
            self._approaches.clear()
        self._reduce()

    def on_command(self, command: Twist) -> str:
        """Take in the safe command that the driver gets."""
        if command is self._command:
            return ""
        self._command = command
        is_linear: cython.bint = self._linear.on_command(command.linear, self._speed, self._stamp)
        is_angular: cython.bint = self._angular.on_command(command.angular, self._rate, self._stamp)
        is_lateral: cython.bint = False
        if self._lateral is not None:
            is_lateral = self._lateral.on_command(command.lateral, self._aside, self._stamp)
            self._linear.share_with(self._lateral, self._aside, self._stamp)
            self._lateral.share_with(self._linear, self._speed, self._stamp)
        if not (is_linear or is_angular or is_lateral):
            return ""
        return self._braked(is_linear, is_angular, is_lateral)

    def on_odometry(self, odometry: Odometry) -> str:
        """Take in a reading: the motion since the reading before is a step of each axis.

        A jump of the clock or the pose drops the stops under way and the scans.
        """
        pose, twist = odometry.pose, odometry.twist
        begin: cython.double = self._stamp
        end: cython.double = odometry.stamp
        x: cython.double = pose.x
        y: cython.double = pose.y
        yaw: cython.double = pose.yaw
        dx: cython.double = x - self._x
        dy: cython.double = y - self._y
        turned: cython.double = remainder(yaw - self._yaw, _turn)
        middle: cython.double = self._yaw + 0.5 * turned
        moved: cython.double = sqrt(dx * dx + dy * dy)
        self._stamp, self._x, self._y, self._yaw = end, x, y, yaw
        self._speed, self._rate, self._aside = twist.linear, twist.angular, twist.lateral
        if end < begin or max(moved, fabs(turned)) > _max_step + _max_speed * (end - begin):
            self._linear.interrupt()
            self._angular.interrupt()
            if self._lateral is not None:
                self._lateral.interrupt()
            self._way_first = self._way_end = 0
            self._scans.clear()
            return ""
        if end == begin or begin == -math.inf:
            return ""
        if dx or dy or turned:
            self._moved += moved + self._radius * fabs(turned)
        at: cython.Py_ssize_t = self._way_end % _MAX_WAYS
        self._way_at[at], self._way[at] = end, self._moved
        self._way_end += 1
        way: cython.double = cos(middle) * dx + sin(middle) * dy
        is_linear: cython.bint = self._linear.on_step(begin, end, way)
        is_angular: cython.bint = self._angular.on_step(begin, end, turned)
        is_lateral: cython.bint = False
        if self._lateral is not None:
            way = cos(middle) * dy - sin(middle) * dx
            is_lateral = self._lateral.on_step(begin, end, way)
        if not (is_linear or is_angular or is_lateral):
            return ""
        return self._braked(is_linear, is_angular, is_lateral)

    def on_scan(self, stamp: float, gap: float | None, delay: float = 0.0) -> str:
        """Take in a scan with its stamp in s and the gap in m to its nearest return.

        `delay` in s is the greatest age of its rays. All that the robot moved since then counts as
        its own motion towards the return. None as gap: no return.
        """
        scans, seen = self._scans, self._approaches
        is_late = scans and not 0.0 < stamp - scans[len(scans) - 1][0] < _MAX_GAP_TIME
        if gap is None or gap > _NEAR or is_late:
            scans.clear()
        if gap is None or gap > _NEAR:
            return ""
        scans.append((stamp, gap, self._moved_until(self._stamp - delay), self._moved))
        while stamp - scans[0][0] > _APPROACH:
            scans.popleft()
        is_apart = not seen or stamp - seen[len(seen) - 1][0] >= _APART
        if len(scans) < _MIN_SCANS or stamp - scans[0][0] < _MIN_APPROACH or not is_apart:
            return ""
        assumed = self._settings.others_speed
        if (scans[0][1] - gap) < _FASTER * assumed * (stamp - scans[0][0]):
            return ""  # the usual case, without a fit
        speed, spread = self._approach()
        if speed - _CERTAIN * spread < _FASTER * assumed:
            return ""
        while self._approaches and stamp - self._approaches[0][0] > _TOGETHER:
            self._approaches.popleft()
        self._approaches.append((stamp, speed, spread))
        came = f"came at {speed:.2f} +- {spread:.2f} m/s, declared at most {assumed:.2f}"
        if len(self._approaches) < 2:
            return f"something {came}"
        _, speed, spread = sorted(self._approaches, key=itemgetter(1), reverse=True)[1]
        came = f"came at {speed:.2f} +- {spread:.2f} m/s or faster, declared at most {assumed:.2f}"
        self._others = f"{len(self._approaches)} things {came}"
        self._others_share = min(assumed / speed, self._others_share)
        return self._reduced(self._others)

    def _approach(self) -> tuple[float, float]:
        """The speed in m/s of the object that approaches, and its standard deviation.

        The slope of the gap over time by least squares, less all that the robot moved since the
        first scan. (0, 0) if the approach is not even.
        """
        times, gaps, begun, moved = np.array(self._scans).T
        times -= times.mean()
        slope = float(times @ gaps / (times @ times))
        off = gaps - gaps.mean() - slope * times
        last = len(times) - 1
        way = fabs(slope * float(times[last] - times[0]))
        if float(np.abs(off).max()) > _STEADY + _STEADY_SHARE * way:
            return 0.0, 0.0
        noise = max(math.sqrt(float(off @ off) / (len(gaps) - 2)), _RANGE_NOISE)
        own = float(moved[last] - begun[0]) / float(times[last] - times[0])
        return -slope - own, noise / math.sqrt(float(times @ times))

    def _moved_until(self, at: float) -> float:
        """`_moved` in m at a stamp of odometry."""
        self._way_first = max(self._way_first, self._way_end - _MAX_WAYS)
        while (
            self._way_first + 1 < self._way_end
            and self._way_at[(self._way_first + 1) % _MAX_WAYS] <= at
        ):
            self._way_first += 1
        has_way = self._way_first < self._way_end
        return self._way[self._way_first % _MAX_WAYS] if has_way else self._moved

    def _braked(self, is_linear: bool, is_angular: bool, is_lateral: bool) -> str:
        """The event of the axes whose braking is now found too weak; sets `speed_share`."""
        evidence = [self._linear.evidence] * is_linear + [self._angular.evidence] * is_angular
        if is_lateral:
            evidence.append(self._lateral.evidence)
        return self._reduced("; ".join(evidence))

    def _reduce(self) -> None:
        """Set `speed_share` by all violations."""
        brake: _Brake
        share: cython.double = self._others_share
        for brake in self._brakes():
            share = min(share, brake.braking / brake.declared)
        self.speed_share = max(share, MIN_SHARE)

    def _reduced(self, text: str) -> str:
        self._reduce()
        return f"{text}: speed reduced to {self.speed_share:.0%}"
