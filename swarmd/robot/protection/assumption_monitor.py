"""Compares the assumptions of mode `barrier` about base and surroundings with measurements. Pure.

Braking of the base:
- A stop begins when the safe command falls clearly. The stop ends when odometry shows that the base
  has followed the command, or when the command rises.
- A model of a base that responds after a delay and brakes evenly is fitted to the distances of all
  periods of odometry, from shortly before the stop. Delay and speed of the base are free, so
  neither late nor rare odometry makes brakes look weak. The residuals of the fits estimate the
  noise of odometry. So a stop with little noise counts more in the test below.
- The test is CUSUM (Page, Biometrika 1954) of two hypotheses: the brakes have the share WEAK of the
  declared braking, or the share SOUND. Each stop adds the logarithm of the likelihood ratio to a
  sum, which never falls below zero. The test alarms if the sum reaches ALARM.
- Brakes with the share SOUND or more cause an alarm in one of e^ALARM stops on average at most
  (Lorden, Annals of Mathematical Statistics 1971). An alarm needs at least three stops, since
  another robot may have pushed this robot during a stop.
- A base that moves sideways has the same declared braking ahead and sideways. In a diagonal stop,
  the wheels of the base share their braking between both axes. So a stop along an axis counts only
  if the speed along the other axis changes little.

Speed of others: the speed at which the gap to the nearest return falls is fitted by least squares
over several scans. All motion of the robot itself and the standard deviations are subtracted. The
rest is compared with `others_speed`. The test finds an object that approaches, but no object that
passes.

Walls that stand (walls/): the layer tells each wall that moved. The second such wall
within 10 min is a violation. No wall counts as standing then, and the full speed is safe. The
violation ends _WALL_DOUBT s after the last wall that moved, or by an operator.

Any other violation reduces the speed of the robot to `speed_share` until an operator ends the
violation, since nothing that happens later proves the assumption again. For braking, the share is
the measured braking (less two standard deviations) over the declared braking. At the reduced speed
the time to stop is as declared, and the distance to stop is shorter. For others, the share is the
assumed speed over the measured speed.

A kernel (see `core/kernels.py`), since each reading of odometry and each command pass it.
"""

from __future__ import annotations

import math
from collections import deque
from operator import itemgetter
from typing import TYPE_CHECKING, Any

import msgspec
import numpy as np

from swarmd.core import cython_shadow as cython
from swarmd.core.angles import TURN
from swarmd.core.buffers import view_of
from swarmd.core.cython_shadow import Doubles, Table, copysign, cos, fabs, remainder, sin, sqrt
from swarmd.core.values import MAX_SPEED, MAX_STEP, ZERO, Array, Odometry, Platform, Twist
from swarmd.robot.protection.decision import MovedWall
from swarmd.robot.protection.settings import BarrierSettings
from swarmd.robot.protection.walls.walls_settings import MOVING_WALL

if TYPE_CHECKING:
    from collections.abc import Collection

MIN_SHARE = 0.2
"""The lowest `speed_share`."""
SOUND = 0.85
WEAK = 0.7
"""Shares of the declared braking between which the test distinguishes."""
ALARM = 14.0
"""The sum of the test at which it alarms: sound brakes do so once in a million stops (e^14)."""

_MOST_OF_A_STOP = 5.0  # the most that one stop adds to the sum: an alarm needs three stops
_SHARES = np.array((*np.geomspace(0.15, 0.63, 11), WEAK, 0.77, SOUND, 0.92, 1.0, 1.1))
_WEAK, _SOUND = (int(np.flatnonzero(share == _SHARES)[0]) for share in (WEAK, SOUND))
_LONGEST_DELAY = 0.6  # s from the command to the stamp at which the base responds
_DELAYS = np.linspace(0.0, _LONGEST_DELAY, 13)
_FINE_DELAYS = np.linspace(-0.04, 0.04, 9)
# Noise of odometry as a share of a reading before any stop, and how many readings it counts for.
_SLIP = 0.05
_SLIP_FREEDOM = 20.0
_MAX_FREEDOM = 400.0  # readings that count for the noise at most, so that older ones fade
_MAX_VARIANCE_RATIO = 9.0  # times the variance: the most that a stop adds to its estimate
# Share of the speed before a stop: a slower reading has the noise of that speed.
_STILL_SHARE = 0.2

_MIN_DROP = 0.08, 0.4  # m/s and rad/s by which the command must fall at once
_MIN_DROP_TIME = 0.1  # s that the fall takes at the declared braking, at least
# Share of the speed: noise of odometry grows with the speed.
_MIN_DROP_SHARE = 0.5
# Share of the command by which the speed may differ from the command before a stop.
_FOLLOWED = 0.15
# Readings before a stop that give its speed: the most and the least.
_CRUISE = 6
_MIN_CRUISE = 2
_MIN_STOP_READINGS = 3  # readings of a stop
_END_SHARE = 0.1  # share of the fall that remains when a stop ends
# Share of the speed by which noise may raise the speed during a stop.
_NOISE_RISE = 0.3
_MAX_WAIT = 1.5  # s in which a stop is judged
_MAX_PERIOD = 0.3  # s between two readings
# Share of the command before a stop by which the command may rise again.
_COMMAND_RISE = 0.2
# Share of the fall of a stop by which the speed on the other axis may change: brakes that both
# axes share then leave 0.96 of the braking for the stop.
_OTHER_AXIS_CHANGE = 0.3
_MAX_COMMANDS = 40
_MAX_TRAVELS = 64

_NEAR_GAP = 1.5  # m within which an approach counts
# s of scans from which a speed is measured: most and least
_MAX_APPROACH_TIME = 0.85
_MIN_APPROACH_TIME = 0.35
_MIN_SCANS = 4  # in that time: a lidar of 5 Hz sees a pedestrian in no more
_MAX_GAP_TIME = 0.6  # s between two scans of one approach
_CLEARLY_FASTER = 1.15  # times others_speed: an approach that is clearly faster
_RANGE_NOISE = 0.01  # m of the nearest range, at least
# m, plus a share of the distance, by which a scan may differ from an even approach: if an object
# appears or is lost, the nearest return jumps.
_MAX_RESIDUAL = 0.03
_MAX_RESIDUAL_SHARE = 0.05
_STANDARD_DEVIATIONS = 3.0  # standard deviations by which an approach must be too fast
# s between two approaches that together are a violation
_MIN_APART = 5.0
_MAX_APART = 600.0
_WALL_DOUBT = 300.0  # s after the last wall that moved, in which no wall counts as standing

RESPONSE = 0.05
"""s after a command within which the base responds, as mode `barrier` assumes."""
_RESPONSES = 9  # the last stops: the base is late if it responded late in all but one
_LATER = 0.05  # s beyond RESPONSE that are late: a reading shows a command up to a period late

_BRAKED = "braked at"
_LATE_WHY = "commands, base or odometry are slow"
_UNITS = "m/s2", "rad/s2", "m/s2 sideways"

_max_step = MAX_STEP
_max_speed = MAX_SPEED
_inf = math.inf


def _last(count: int, most: int) -> range:
    """The indices of the last `most` of `count` items."""
    return range(max(count - most, 0), count)


def _is_apart(events: deque[Any], stamp: float) -> bool:
    """True if the last of `events` is _MIN_APART s old at `stamp` or older, or if none is left.

    First drops events that are older than _MAX_APART s, or of a clock that was set back. `events`
    are tuples that begin with the stamp in s.
    """
    while events and not 0.0 <= stamp - events[0][0] <= _MAX_APART:
        events.popleft()
    return not events or stamp - events[len(events) - 1][0] >= _MIN_APART


def axis_of(finding: str) -> str | None:
    """`linear`, `angular` or `lateral` for a finding about brakes; None for one about others."""
    if not finding.startswith(_BRAKED):
        return None
    if _UNITS[2] in finding:
        return "lateral"
    return "angular" if _UNITS[1] in finding else "linear"


@cython.cclass
class _Stop:
    """A fall of the command of one axis, and the motion by odometry before and after.

    Speeds are relative to `sign`, so they are positive before the stop.
    """

    sign: float  # 1 or -1: the direction of the motion before the stop
    begin_speed: float  # speed commanded before the stop
    least_speed: float  # lowest speed commanded since
    fell_at: float  # stamp of odometry at which the command fell
    # Periods of odometry before and after the fall: stamp at begin, stamp at end, m or rad moved.
    cruise: list[Any]
    steps: list[Any]

    def __init__(
        self, sign: float, begin_speed: float, least_speed: float, fell_at: float, cruise: list[Any]
    ) -> None:
        self.sign = sign
        self.fell_at = fell_at
        self.begin_speed = begin_speed
        self.least_speed = least_speed
        self.cruise = cruise
        self.steps = []


@cython.cclass
class _Brake:
    """Judges the stops of one axis (ahead, turning or sideways)."""

    declared: float  # m/s2 or rad/s2, the declared braking
    braking: float  # m/s2 or rad/s2, as declared, or measured and weaker
    evidence: str  # text on how the weaker braking was measured; empty without a violation
    late: str  # text on how late the base responds; empty if it is not too late
    _unit: str
    _delays: deque[float]
    _min_drop: float  # m/s or rad/s, the least fall of the command that begins a stop
    _stop: _Stop | None  # the stop under way; None without one
    _command: float  # the last command
    # Ring buffers (item k is at k modulo the length). The commands: how many were given, the stamp
    # since which each holds, its speed.
    _commands: int
    _stamps: cython.double[40]
    _speeds: cython.double[40]
    # The periods of odometry in which the base followed a constant command: how many, and of each
    # the stamp at begin, the stamp at end, and m or rad moved.
    _cruise_count: int
    _cruise: cython.double[18]
    _variance: float  # of the noise of odometry, as a share of a reading
    _freedom: float  # degrees of freedom of this estimate
    # The CUSUM test: the sum, the stops since it was zero, and the summed misfits by share.
    _log_likelihood_sum: float
    _stop_count: int
    _misfits: Array

    def __init__(self, declared: float, min_drop: float, unit: str) -> None:
        self.declared = declared
        self._unit = unit
        self._min_drop = max(min_drop, _MIN_DROP_TIME * declared)
        self.interrupt()
        # of a reading, as a share of it
        self._variance = _SLIP**2
        self._freedom = _SLIP_FREEDOM
        self._delays = deque(maxlen=_RESPONSES)
        self.late = ""
        self.forget()

    def check_indices(self) -> None:
        """ValueError unless its counts are of its arrays; see `recall`."""
        if not (0 <= self._commands < 1 << 60 and 0 <= self._cruise_count < 1 << 60):
            raise ValueError(f"{self._commands} commands and {self._cruise_count} steps of a brake")

    def forget(self) -> None:
        """Trust the declared braking again, and begin the test anew."""
        self.braking = self.declared
        self.evidence = ""
        self._begin()

    def interrupt(self) -> None:
        """Drop the stop under way, as after a jump of the clock or the pose of odometry."""
        self._stop = None
        self._cruise_count = 0
        self._commands = 0
        self._note(-math.inf, self._command)

    def share_with(self, axis: _Brake, speed: float, stamp: float) -> None:
        """Drop the stop under way if the speed on the other axis changes, too.

        The base may still follow any command of the last _LONGEST_DELAY s. So the present command
        of the other axis is compared with the measured speed, and with each command of this time.
        The greatest difference counts as the change of speed.

        `axis`: the other axis. `speed`: m/s, the last measured speed along the other axis.
        `stamp`: s, of this measurement.
        """
        stop: _Stop | None = self._stop
        if stop is None:
            return
        change = fabs(axis._command - speed)
        for k in range(axis._commands - 1, max(axis._commands - _MAX_COMMANDS, 0) - 1, -1):
            change = max(change, fabs(axis._command - axis._speeds[k % _MAX_COMMANDS]))
            if axis._stamps[k % _MAX_COMMANDS] <= stamp - _LONGEST_DELAY:
                break
        if change > _OTHER_AXIS_CHANGE * (stop.begin_speed - stop.least_speed):
            self._stop = None

    def _note(self, stamp: float, command: float) -> None:
        """Store a command, which holds from the stamp on, in the ring buffers."""
        place = self._commands % _MAX_COMMANDS
        self._stamps[place] = stamp
        self._speeds[place] = command
        self._commands += 1

    def _begin(self) -> None:
        self._log_likelihood_sum = 0.0
        self._stop_count = 0
        self._misfits = np.zeros(len(_SHARES))

    def on_command(self, command: float, speed: float, stamp: float) -> bool:
        """Take in a command of this axis; True if the command ends a stop that shows weak brakes.

        A command that falls clearly begins a stop, if the base moved as commanded before. A command
        that rises clearly ends the stop under way.

        Args:
            command: m/s or rad/s.
            speed: m/s or rad/s, the last measured speed.
            stamp: s, of this measurement.
        """
        previous = self._command
        if command == previous:
            return False
        self._command = command
        self._note(stamp, command)

        # 1. A stop is under way: the command continues the stop, or ends the stop by a rise.
        stop: _Stop | None = self._stop
        if stop is not None:
            new_speed = max(stop.sign * command, 0.0)
            stop.least_speed = min(new_speed, stop.least_speed)
            if new_speed <= stop.least_speed + _COMMAND_RISE * stop.begin_speed:
                return False
            return self._end(stop)

        # 2. The usual case, decided fast: a change that is too small even if it were a fall.
        change = previous - command if previous > 0.0 else command - previous
        if change < self._min_drop:
            return False

        # 3. Relative to the motion before, a reversed command is a fall to 0.
        begin_speed = fabs(previous)
        sign = copysign(1.0, previous)
        new_speed = max(sign * command, 0.0)
        drop = begin_speed - new_speed
        if drop < self._min_drop or drop < _MIN_DROP_SHARE * begin_speed:
            return False

        # 4. A stop begins, if odometry shows that the base followed the command before.
        if fabs(speed - previous) <= _FOLLOWED * begin_speed and self._cruise_count >= _MIN_CRUISE:
            self._stop = _Stop(sign, begin_speed, new_speed, stamp, self._last_cruise())
        self._cruise_count = 0
        return False

    def _last_cruise(self) -> list[Any]:
        """The last periods in which the base followed a constant command: begin, end, m or rad."""
        starts = [3 * (k % _CRUISE) for k in _last(self._cruise_count, _CRUISE)]
        return [(self._cruise[k], self._cruise[k + 1], self._cruise[k + 2]) for k in starts]

    def on_step(self, begin: float, end: float, moved: float) -> bool:
        """Take in a period of odometry; True if the period ends a stop that shows weak brakes.

        Without a stop under way, the call collects the periods in which the base follows a constant
        command. During a stop, the call collects the periods of the stop. The stop ends once the
        base has followed the fall of the command, or after _MAX_WAIT s.

        Args:
            begin: s, the stamp of the first reading.
            end: s, the stamp of the second reading.
            moved: m or rad that the base moved between the two readings.
        """
        stop: _Stop | None = self._stop
        if stop is None:
            self._cruise_on(begin, end, moved)
            return False
        stop.steps.append((begin, end, moved))
        period = end - begin
        speed = stop.sign * moved / period
        was_pushed = speed > (1.0 + _NOISE_RISE) * stop.begin_speed
        if was_pushed or period > _MAX_PERIOD:  # or readings of odometry were lost
            self._stop = None
            return False
        fall = stop.begin_speed - stop.least_speed
        has_followed = speed - stop.least_speed <= _END_SHARE * fall
        if not has_followed and end - stop.fell_at <= _MAX_WAIT:
            return False
        return self._end(stop)

    def _cruise_on(self, begin: float, end: float, moved: float) -> None:
        """Store a period in which the base moves and follows its command.

        Any other period drops the stored periods. `begin`, `end`: s, the stamps of two readings of
        odometry. `moved`: m or rad that the base moved between the two readings.
        """
        commanded = self._command * (end - begin)
        if commanded == 0.0 or fabs(moved - commanded) > _FOLLOWED * fabs(commanded):
            self._cruise_count = 0
            return
        # Where the three numbers of this period begin in the ring buffer.
        start = 3 * (self._cruise_count % _CRUISE)
        self._cruise[start] = begin
        self._cruise[start + 1] = end
        self._cruise[start + 2] = moved
        self._cruise_count += 1

    def _end(self, stop: _Stop) -> bool:
        """End the stop and judge the stop; True: the brakes are too weak.

        The stop updates the estimates of the delay and of the noise, and the CUSUM test.
        """
        self._stop = None
        self._cruise_count = 0
        if len(stop.steps) < _MIN_STOP_READINGS:
            return False

        # 1. Fits the model of the base for each share of the braking assumed so far.
        places = [k % _MAX_COMMANDS for k in _last(self._commands, _MAX_COMMANDS)]
        commands = [(self._stamps[k], self._speeds[k]) for k in places]
        misfits, freedom, delay = _misfits(stop, commands, self.braking)

        # 2. The delay of the response, known up to the mean time between two readings of the stop.
        mean_period = (stop.steps[len(stop.steps) - 1][1] - stop.fell_at) / len(stop.steps)
        self._respond(delay, mean_period)

        # 3. The noise of odometry, by the best fit.
        least_misfit = float(misfits.min())
        stop_variance = least_misfit / freedom
        self._pool_variance(stop_variance, freedom)

        # 4. The test. The greater variance counts, so that a noisy stop weighs less.
        chi_squares = (misfits - least_misfit) / max(self._variance, stop_variance)
        return self._sum_up(chi_squares)

    def _pool_variance(self, stop_variance: float, freedom: float) -> None:
        """Pool the variance of a stop with the estimate so far, by their degrees of freedom."""
        bounded_variance = min(stop_variance, _MAX_VARIANCE_RATIO * self._variance)
        pooled_sum = self._variance * self._freedom + bounded_variance * freedom
        self._freedom += freedom
        self._variance = pooled_sum / self._freedom
        self._freedom = min(self._freedom, _MAX_FREEDOM)

    def _sum_up(self, chi_squares: Array) -> bool:
        """Add a stop to the CUSUM test; True if the test alarms.

        `chi_squares`: by share of _SHARES, the misfit of the stop over the variance; 0 for the best
        fit. Half of a difference of two chi-squares is the logarithm of a likelihood ratio. This
        logarithm is positive if the share WEAK fits better than the share SOUND.
        """
        log_ratio = 0.5 * float(chi_squares[_SOUND] - chi_squares[_WEAK])
        self._log_likelihood_sum += min(log_ratio, _MOST_OF_A_STOP)
        if self._log_likelihood_sum <= 0.0:
            self._begin()
            return False
        self._stop_count += 1
        self._misfits += chi_squares
        if self._log_likelihood_sum < ALARM:
            return False
        self._conclude()
        return True

    def _respond(self, delay: float, period: float) -> None:
        """Note the `delay` in s of the response in a stop, and set `late`.

        `period`: s between two readings. A reading shows the response up to a period late, so the
        period is subtracted from the delay.
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

    def _conclude(self) -> None:
        """Set `braking` and `evidence` by the stops of the test, and begin the test anew.

        `braking` becomes the measured braking less two standard deviations.
        """
        slowness, slowness_deviation = _best_slowness(self._misfits)
        previous = self.braking  # the shares of the test are shares of this braking
        measured = previous / slowness
        spread = measured * slowness_deviation / slowness
        self.braking = min(max(measured - 2.0 * spread, MIN_SHARE * measured), previous)
        unit = self._unit
        stops = self._stop_count
        self.evidence = (
            f"{_BRAKED} {measured:.2f} +- {spread:.2f} {unit} in {stops} stops, declared"
            f" {self.declared:.2f}"
        )
        self._begin()


def _best_slowness(misfits: Array) -> tuple[float, float]:
    """The slowness of the brakes that fits best, and its standard deviation.

    The slowness is 1 over the share of the braking: 2 means half of the braking. `misfits` (s,) are
    chi-squares by share of _SHARES. A parabola is fitted to the least misfit and its neighbours, as
    a function of the slowness. A chi-square rises by 1 at one standard deviation from its minimum,
    so the standard deviation is 1 / sqrt(curvature).
    """
    best = int(misfits.argmin())
    slowness = 1.0 / _SHARES
    i = min(max(best, 1), len(_SHARES) - 2)
    neighbours = slice(i - 1, i + 2)
    curvature, gradient, _ = np.polyfit(slowness[neighbours], misfits[neighbours], 2)
    optimum = float(-0.5 * gradient / curvature) if curvature > 0.0 else float(slowness[best])
    lowest = float(slowness[neighbours].min())
    highest = float(slowness[neighbours].max())
    return min(max(optimum, lowest), highest), 1.0 / math.sqrt(max(float(curvature), 1e-6))


def _misfits(stop: _Stop, commands: list[Any], full_braking: float) -> tuple[Array, float, float]:
    """Fit a model of the base to the readings of a stop, for each share in _SHARES.

    The model responds to its command after a delay, accelerates at once, and brakes evenly. The
    delay, and the scale of the speeds, are free.

    Args:
        stop: the stop, with the periods of odometry before and after the fall of the command.
        commands: (stamp, speed) pairs: the speed commanded from this stamp on.
        full_braking: m/s2 or rad/s2, the braking of share 1: as declared, or as measured in an
            earlier violation.

    Returns:
        (s,) the weighted sum of squared residuals for each share. Then the degrees of freedom. Then
            the delay in s of the share that fits best.
    """
    readings = np.array((*stop.cruise, *stop.steps))
    periods = readings[:, 1] - readings[:, 0]
    distances = stop.sign * readings[:, 2]

    # 1. The commands that the base may have followed. Before the first command the speed is 0.
    stamps, speeds = np.array(_since(commands, readings[0, 0] - _LONGEST_DELAY)).T
    stamps = view_of(np.concatenate(([-np.inf], stamps)))
    speeds = np.maximum(stop.sign * speeds, 0.0)
    speeds = view_of(np.concatenate(([0.0], speeds)))

    # 2. Weights: the noise of a distance grows with the distance. A reading near standstill has the
    # noise of a share of the speed before the stop.
    cruise_count = len(stop.cruise)
    cruise_speed = float(distances[:cruise_count].sum() / periods[:cruise_count].sum())
    weights = 1.0 / (distances**2 + (_STILL_SHARE * cruise_speed * periods) ** 2)
    table = view_of(np.stack((readings[:, 0], periods, weights * distances, weights), axis=1))

    # 3. The braking of each share, scaled from speeds by odometry to the commanded speeds of the
    # model: before the stop, `cruise_speed` by odometry was `begin_speed` by the command.
    brakings = view_of(_SHARES * full_braking * stop.begin_speed / cruise_speed)

    # 4. The least weighted residuals for each braking.
    misfits, delays = np.asarray(
        _weighted_residuals(table, stamps, speeds, brakings, float(weights @ distances**2))
    )
    fitted_numbers = 3.0  # the delay, the scale and the braking
    freedom = max(len(distances) - fitted_numbers, 1.0)
    return misfits, freedom, float(delays[misfits.argmin()])


def _since(commands: list[Any], earliest_stamp: float) -> list[Any]:
    """The (stamp, speed) pairs of commands that still held after `earliest_stamp` in s.

    A command holds until the next command; the last command always still holds. Commands that held
    for 0 s are left out: several commands may come between two readings of odometry.
    """
    last = len(commands) - 1
    used = []
    for k, command in enumerate(commands[:last]):
        stamp = command[0]
        next_stamp = commands[k + 1][0]
        if earliest_stamp < next_stamp and next_stamp != stamp:
            used.append(command)
    return [*used, commands[last]]


def _weighted_residuals(
    periods: Table, stamps: Doubles, speeds: Doubles, brakings: Doubles, total: float
) -> Any:
    """The least weighted sums of squared residuals of the model of the base, and their delays.

    (2, s): row 0 has the least sum for each braking of `brakings` (s,), row 1 the delay in s that
    gives this sum.

    Args:
        periods: (n, 4), of each period: begin, duration, weight times distance, weight.
        stamps: (m,) s, since when each command holds. Command 0 is standstill, since -inf.
        speeds: (m,) m/s or rad/s, the speed of each command.
        brakings: (s,) m/s2 or rad/s2, in the scale of the commanded speeds.
        total: the weighted sum of the squared distances.
    """
    coarse: Doubles = view_of(_DELAYS)
    fine: Doubles = view_of(_FINE_DELAYS)
    model_speeds: Doubles = view_of(np.zeros(len(stamps)))
    result: Table = view_of(np.zeros((2, len(brakings))))
    for j in range(len(brakings)):
        braking = brakings[j]
        _model_speeds_at(stamps, speeds, braking, model_speeds)

        # 1. The best delay of the coarse grid.
        best_coarse = 0.0
        least = _inf
        for k in range(len(coarse)):
            residual = _residual(periods, stamps, speeds, model_speeds, braking, coarse[k], total)
            if residual < least:
                least = residual
                best_coarse = coarse[k]

        # 2. The best delay of the fine grid around this delay.
        result[0, j] = _inf
        result[1, j] = best_coarse
        for k in range(len(fine)):
            delay = best_coarse + fine[k]
            residual = _residual(periods, stamps, speeds, model_speeds, braking, delay, total)
            if residual < result[0, j]:
                result[0, j] = residual
                result[1, j] = delay
    return result


def _model_speeds_at(
    stamps: Doubles, speeds: Doubles, braking: float, model_speeds: Doubles
) -> None:
    """Set `model_speeds` (m,): the speed of the model at the stamp of each command.

    The model brakes evenly while its speed is above the commanded speed. Command 0 is standstill,
    so the model stands until the stamp of command 1: the first two speeds stay 0.

    `stamps` (m,) s: since when each command holds. `speeds` (m,) m/s or rad/s: of each command.
    `braking`: m/s2 or rad/s2, in the scale of `speeds`.
    """
    for k in range(2, len(stamps)):
        braked_speed = model_speeds[k - 1] - braking * (stamps[k] - stamps[k - 1])
        model_speeds[k] = max(speeds[k - 1], braked_speed)


def _residual(
    periods: Table,
    stamps: Doubles,
    speeds: Doubles,
    model_speeds: Doubles,
    braking: float,
    delay: float,
    total: float,
) -> float:
    """The weighted sum of squared residuals of the model with a braking and a delay.

    The speeds of the model are scaled by a factor, since odometry and base may be off by a few
    percent. The factor that fits best leaves the sum

        total - (weighted products of model and distance)^2 / (weighted squares of the model).

    Args:
        periods: (n, 4), of each period: begin, duration, weight times distance, weight.
        stamps: (m,) s, since when each command holds. Command 0 is standstill, since -inf.
        speeds: (m,) m/s or rad/s, the speed of each command.
        model_speeds: (m,) m/s or rad/s, the speed of the model at the stamp of each command.
        braking: m/s2 or rad/s2, in the scale of `speeds`.
        delay: s by which the model follows each command.
        total: the weighted sum of the squared distances.
    """
    command = 0  # the index of the command that holds
    count = len(stamps)
    cross_sum = 0.0
    model_sum = 0.0
    for i in range(len(periods)):
        period_begin = periods[i, 0]
        duration = periods[i, 1]
        weighted_distance = periods[i, 2]
        weight = periods[i, 3]
        speed_sum = 0.0
        for part in range(2):  # the speeds at a quarter and three quarters of the period
            # The command that holds at `stamp`. The search goes forwards and back, so the periods
            # may be in any order. It ends at command 0 at the latest, which holds since -inf.
            stamp = period_begin + (0.25 + 0.5 * part) * duration - delay
            while command + 1 < count and stamps[command + 1] <= stamp:
                command += 1
            while stamps[command] > stamp:
                command -= 1
            braked_speed = model_speeds[command] - braking * (stamp - stamps[command])
            speed_sum += max(speeds[command], braked_speed)
        modelled = 0.5 * speed_sum * duration  # m or rad
        cross_sum += modelled * weighted_distance
        model_sum += modelled * modelled * weight
    return total - cross_sum * cross_sum / max(model_sum, 1e-12)


@cython.cclass
class AssumptionMonitor:
    """Watches braking and the speed of others for one robot.

    The methods that take inputs return the text of an event for the robot's log, or an empty text.
    `speed_share` in [MIN_SHARE, 1] is the share of the safe command that the base may get.
    """

    speed_share: float
    _settings: BarrierSettings
    _radius: float
    _linear: _Brake
    _angular: _Brake
    _lateral: _Brake | None  # None: the base cannot move sideways
    _command: Twist
    # The last reading: its stamp, pose and speeds.
    _stamp: float
    _x: float
    _y: float
    _yaw: float
    _linear_speed: float
    _angular_speed: float
    _lateral_speed: float
    _travelled: float  # m that any corner may have moved so far
    # A ring buffer of the last stamps of odometry, and of `_travelled` at each. Item k is at k
    # modulo the length; items from `_travel_first` to before `_travel_end` are in use.
    _travel_stamps: cython.double[64]
    _travels: cython.double[64]
    _travel_first: int
    _travel_end: int
    # Of the last scans: stamp, gap, `_travelled` when the oldest ray was measured, and on arrival.
    _gaps: deque[tuple[float, float, float, float]]
    _approach_text: str  # text on objects that are too fast; empty without a violation
    _approach_share: float  # of `speed_share`
    _approaches: deque[
        tuple[float, float, float]
    ]  # the approaches that were too fast: stamp, m/s, standard deviation
    _wall_text: str  # text on walls that moved; empty without a violation
    _wall_moves: deque[tuple[float, float]]  # the walls that moved: stamp, m/s
    _wall_moved_at: float  # the stamp of the last wall that moved

    def __init__(self, platform: Platform) -> None:
        settings = msgspec.convert(platform.protection["barrier"], BarrierSettings)
        self._settings = settings
        self._radius = float(np.hypot(*platform.footprint.T).max())
        self._linear = _Brake(settings.braking_linear, _MIN_DROP[0], _UNITS[0])
        self._angular = _Brake(settings.braking_angular, _MIN_DROP[1], _UNITS[1])
        is_lateral = platform.limits.lateral > 0.0
        sideways = _Brake(settings.braking_linear, _MIN_DROP[0], _UNITS[2]) if is_lateral else None
        self._lateral = sideways
        self._command = ZERO
        self._stamp = -math.inf
        self._gaps = deque(maxlen=64)
        self._approaches = deque()
        self._approach_text = ""
        self._approach_share = 1.0
        self.speed_share = 1.0
        self._wall_text = ""
        self._wall_moves = deque()
        self._wall_moved_at = -math.inf

    def check_indices(self) -> None:
        """ValueError unless its counts are of its arrays; see `recall`."""
        if not (0 <= self._travel_first < 1 << 60 and 0 <= self._travel_end < 1 << 60):
            raise ValueError(f"ways from {self._travel_first} to {self._travel_end}")

    @property
    def findings(self) -> tuple[str, ...]:
        """The violated assumptions, each with its evidence."""
        brake: _Brake
        evidence = []
        for brake in self._brakes():
            evidence.append(brake.evidence)
        return tuple(text for text in (*evidence, self._approach_text, self._wall_text) if text)

    @property
    def trusts_walls(self) -> bool:
        """False after walls were found to move that had stood, until the finding ends."""
        return not self._wall_text

    def end_wall_doubt(self, stamp: float) -> None:
        """End the finding on walls if no wall has moved in the _WALL_DOUBT s before `stamp`."""
        if self._wall_text and stamp - self._wall_moved_at > _WALL_DOUBT:
            self.forget((self._wall_text,))

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
        if self._approach_text in findings:
            self._approach_text = ""
            self._approach_share = 1.0
            self._approaches.clear()
        if self._wall_text in findings:
            self._wall_text = ""
            self._wall_moves.clear()
        self._reduce()

    def on_command(self, command: Twist) -> str:
        """Take in the safe command that the driver gets; return the text of a found violation."""
        if command is self._command:
            return ""
        self._command = command
        is_linear_weak = self._linear.on_command(command.linear, self._linear_speed, self._stamp)
        is_angular_weak = self._angular.on_command(
            command.angular, self._angular_speed, self._stamp
        )
        is_lateral_weak = False
        if self._lateral is not None:
            is_lateral_weak = self._lateral.on_command(
                command.lateral, self._lateral_speed, self._stamp
            )
            self._linear.share_with(self._lateral, self._lateral_speed, self._stamp)
            self._lateral.share_with(self._linear, self._linear_speed, self._stamp)
        if not (is_linear_weak or is_angular_weak or is_lateral_weak):
            return ""
        return self._braked(is_linear_weak, is_angular_weak, is_lateral_weak)

    def on_odometry(self, odometry: Odometry) -> str:
        """Take in a reading of odometry; return the text of a found violation, or an empty text.

        The motion since the reading before is a period of each axis: ahead, turning, sideways. A
        jump of the clock or of the pose drops the stops under way and the scans.
        """
        pose = odometry.pose
        twist = odometry.twist
        begin = self._stamp
        end = odometry.stamp
        x = pose.x
        y = pose.y
        yaw = pose.yaw
        dx = x - self._x
        dy = y - self._y
        turned = remainder(yaw - self._yaw, TURN)
        middle_yaw = self._yaw + 0.5 * turned
        distance = sqrt(dx * dx + dy * dy)
        self._stamp = end
        self._x = x
        self._y = y
        self._yaw = yaw
        self._linear_speed = twist.linear
        self._angular_speed = twist.angular
        self._lateral_speed = twist.lateral

        # 1. A jump: begins anew.
        if end < begin or max(distance, fabs(turned)) > _max_step + _max_speed * (end - begin):
            self._linear.interrupt()
            self._angular.interrupt()
            if self._lateral is not None:
                self._lateral.interrupt()
            self._travel_first = 0
            self._travel_end = 0
            self._gaps.clear()
            return ""
        if end == begin or begin == -math.inf:  # the same or the first reading: no period
            return ""

        # 2. The travel of the outermost corner, for the speed of approaching objects.
        if dx or dy or turned:
            self._travelled += distance + self._radius * fabs(turned)
        place = self._travel_end % _MAX_TRAVELS
        self._travel_stamps[place] = end
        self._travels[place] = self._travelled
        self._travel_end += 1

        # 3. The motion of each axis, in the direction of the mean yaw.
        axis_distance = cos(middle_yaw) * dx + sin(middle_yaw) * dy
        is_linear_weak = self._linear.on_step(begin, end, axis_distance)
        is_angular_weak = self._angular.on_step(begin, end, turned)
        is_lateral_weak = False
        if self._lateral is not None:
            axis_distance = cos(middle_yaw) * dy - sin(middle_yaw) * dx
            is_lateral_weak = self._lateral.on_step(begin, end, axis_distance)
        if not (is_linear_weak or is_angular_weak or is_lateral_weak):
            return ""
        return self._braked(is_linear_weak, is_angular_weak, is_lateral_weak)

    def on_scan(self, stamp: float, gap: float | None, delay: float = 0.0) -> str:
        """Take in the gap to the nearest return; return the text of an event, or an empty text.

        The event is an approach that is clearly faster than `others_speed`. A second fast approach,
        5 s to 600 s after the first, is a violation, which slows the robot.

        Args:
            stamp: s, of the scan.
            gap: m from the outline to the nearest return; None without a return.
            delay: s, the greatest age of a ray of the scan. The nearest return may be of any ray.
                So all motion of the robot since the oldest ray counts as motion towards the return.
        """
        gaps = self._gaps

        # 1. Collects scans of one approach: near returns without a pause.
        if gap is None or gap > _NEAR_GAP:
            gaps.clear()
            return ""
        if gaps and not 0.0 < stamp - gaps[len(gaps) - 1][0] < _MAX_GAP_TIME:
            gaps.clear()
        gaps.append((stamp, gap, self._travelled_until(self._stamp - delay), self._travelled))
        while stamp - gaps[0][0] > _MAX_APPROACH_TIME:
            gaps.popleft()

        # 2. Are there enough scans? Several scans of one approach count once.
        is_new_approach = _is_apart(self._approaches, stamp)
        first_stamp = gaps[0][0]
        first_gap = gaps[0][1]
        seconds = stamp - first_stamp
        if len(gaps) < _MIN_SCANS or seconds < _MIN_APPROACH_TIME or not is_new_approach:
            return ""

        # 3. Is the approach clearly too fast, by the first and the last gap? Most are not, and need
        # no fit.
        too_fast = _CLEARLY_FASTER * self._settings.others_speed
        if first_gap - gap < too_fast * seconds:
            return ""

        # 4. Is the approach clearly too fast by the fit, too?
        speed, spread = self._approach()
        if speed - _STANDARD_DEVIATIONS * spread < too_fast:
            return ""
        return self._count_approach(stamp, speed, spread)

    def _count_approach(self, stamp: float, speed: float, spread: float) -> str:
        """Count an approach that was too fast; return the text of the event.

        The evidence of a violation is the second fastest approach: at least two approaches were
        that fast. `speed`, `spread`: m/s, of the approach, and its standard deviation.
        """
        assumed = self._settings.others_speed
        self._approaches.append((stamp, speed, spread))
        evidence = f"came at {speed:.2f} +- {spread:.2f} m/s, declared at most {assumed:.2f}"
        if len(self._approaches) < 2:
            return f"something {evidence}"
        _, speed, spread = sorted(self._approaches, key=itemgetter(1), reverse=True)[1]
        evidence = (
            f"came at {speed:.2f} +- {spread:.2f} m/s or faster, declared at most {assumed:.2f}"
        )
        self._approach_text = f"{len(self._approaches)} things {evidence}"
        self._approach_share = min(assumed / speed, self._approach_share)
        return self._reduced(self._approach_text)

    def on_moved_wall(self, stamp: float, moved: MovedWall) -> str:
        """Take in a wall that had stood and has moved; return the text of an event.

        After a second wall that moves, _MIN_APART to _MAX_APART s later, no wall is trusted.
        """
        moves = self._wall_moves
        evidence = (
            f"{MOVING_WALL}: a wall that stood for {moved.stood:.0f} s moved"
            f" {moved.distance:.2f} m at {moved.speed:.2f} m/s"
        )
        self._wall_moved_at = stamp
        if not _is_apart(moves, stamp):
            return evidence
        moves.append((stamp, moved.speed))
        if len(moves) < 2:
            return evidence
        _, speed = sorted(moves, key=itemgetter(1), reverse=True)[1]
        self._wall_text = (
            f"{MOVING_WALL}: {len(moves)} walls moved at {speed:.2f} m/s or faster, declared to"
            f" stand; the last one had stood for {moved.stood:.0f} s"
        )
        return f"{self._wall_text}: no wall counts as standing"

    def _approach(self) -> tuple[float, float]:
        """The speed in m/s of the object that approaches, and its standard deviation.

        The speed is the slope of the gap over time by least squares, less the speed of the robot's
        own travel since the first scan. (0, 0) if the gap does not fall evenly.
        """
        times, gaps, travelled_before, travelled = np.array(self._gaps).T
        times -= times.mean()
        slope = float(times @ gaps / (times @ times))
        residuals = gaps - gaps.mean() - slope * times
        last = len(times) - 1
        fitted_distance = fabs(slope * float(times[last] - times[0]))
        if float(np.abs(residuals).max()) > _MAX_RESIDUAL + _MAX_RESIDUAL_SHARE * fitted_distance:
            return 0.0, 0.0
        noise = max(math.sqrt(float(residuals @ residuals) / (len(gaps) - 2)), _RANGE_NOISE)
        robot_speed = float(travelled[last] - travelled_before[0]) / float(times[last] - times[0])
        return -slope - robot_speed, noise / math.sqrt(float(times @ times))

    def _travelled_until(self, stamp: float) -> float:
        """`_travelled` in m at a stamp of odometry."""
        self._travel_first = max(self._travel_first, self._travel_end - _MAX_TRAVELS)
        while (
            self._travel_first + 1 < self._travel_end
            and self._travel_stamps[(self._travel_first + 1) % _MAX_TRAVELS] <= stamp
        ):
            self._travel_first += 1
        has_travel = self._travel_first < self._travel_end
        return self._travels[self._travel_first % _MAX_TRAVELS] if has_travel else self._travelled

    def _braked(self, is_linear_weak: bool, is_angular_weak: bool, is_lateral_weak: bool) -> str:
        """The event of the axes whose braking is now found too weak; sets `speed_share`."""
        evidence = []
        if is_linear_weak:
            evidence.append(self._linear.evidence)
        if is_angular_weak:
            evidence.append(self._angular.evidence)
        if is_lateral_weak and self._lateral is not None:
            evidence.append(self._lateral.evidence)
        return self._reduced("; ".join(evidence))

    def _reduce(self) -> None:
        """Set `speed_share` by all violations."""
        brake: _Brake
        share = self._approach_share
        for brake in self._brakes():
            share = min(share, brake.braking / brake.declared)
        self.speed_share = max(share, MIN_SHARE)

    def _reduced(self, text: str) -> str:
        self._reduce()
        return f"{text}: speed reduced to {self.speed_share:.0%}"
