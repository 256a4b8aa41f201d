"""Compares the motion of a base with its commands, which a base may refuse or change. Pure.

Two models bound the speed of a base that follows its commands. A fast base has the speed of any
command of the last WINDOW s. A slow base responds DELAY s late, with a quarter of the declared
braking. A base does not follow its commands if its speed is outside these bounds for MIN_DURATION
s, by more than SLIP times the commanded speed.

This result is a text and changes no motion, since a reflex of the base, a stuck wheel and another
node that drives look alike.

A base is blocked if it stands, and has moved less than half of the way that is demanded. The way is
summed over some BLOCKED_TIME s, so that commands that come and go count, too. The demanded speed is
that of the slow base, or the command if it is slower. It is zero while the command reverses the
slow base or the base moves in the other direction, and then rises as the speed of the slow base:
most bases reverse faster than the slow base, and need time to reverse again. Motion in the other
direction does not count.

Odometry contradicts itself if the ways by the pose and by the twist differ, over some AGREE_TIME s,
by more than a tolerance and a share of the path, or if the pose jumps again and again. Such
odometry changes no motion either. A single jump is a correction of the pose or its reset to zero.
A jump that no base can make also begins both comparisons again.

A kernel (see `core/kernels.py`), since each reading of odometry and each command pass it.
"""

from __future__ import annotations

import math

import msgspec

from swarmd.core import cython_shadow as cython
from swarmd.core.angles import TURN
from swarmd.core.buffers import doubles
from swarmd.core.cython_shadow import NAN, Doubles, copysign, cos, fabs, remainder, sin, sqrt
from swarmd.core.values import MAX_SPEED, MAX_STEP, ZERO, Odometry, Platform, Twist
from swarmd.robot.protection.settings import BarrierSettings

MIN_DURATION = 0.7
"""Seconds for which the speed must be outside the bounds."""
WINDOW = 1.0
"""Seconds for which a command counts for the fast base."""
DELAY = 0.3
"""Seconds after a command at which the slow base begins to respond."""
SLIP = 0.5
"""Share of the commanded speed by which the speed may be outside the bounds."""

BLOCKED_TIME = 1.0
"""Seconds in which a way fades from the sums by which a base is blocked."""
_BLOCKED_SHARE = 0.5  # of the demanded way: less is blocked
_LEAST_WAY = 0.08  # m (or rad) demanded in BLOCKED_TIME

AGREE_TIME = 5.0
"""Seconds in which a way fades from the sums that compare pose and twist."""
_AGREE_SHARE = 0.2  # of the path: slip, scale, a late twist
_TOLERANCES = 0.15, 0.5, 0.15  # m, rad and m to the left by which the ways may differ besides
_JUMP_TIME = 30.0  # s in which a jump fades
_JUMPS = 1.5  # faded jumps that are more than one correction
# What a changing speed adds to a step of the pose, in tolerances per s2: 3 m/s2, 10 rad/s2.
_BEYOND = 20.0

# m/s, rad/s and m/s to the left: slower commands may not overcome the friction of a base.
_LEAST = 0.05, 0.25, 0.05
_BRAKING = 1.0, 3.0  # m/s2 and rad/s2 where the platform declares none
_SLOW = 0.25  # share of the declared braking
_MAX_PERIOD = 0.3  # s between two readings
_MIN_READINGS = 4
_COMMANDS = 16  # for which there is room at first
_UNITS = "m/s", "rad/s", "m/s to the left"
_WHY = "a reflex of the base, a stuck wheel, or another node drives"
_WRONG = "one of both stands still, jumps, or has a wrong sign, scale or frame"

_max_step = MAX_STEP
_max_speed = MAX_SPEED
_inf = math.inf


@cython.cclass
class _Axis:
    """Compares the commands and the motion of one axis; times are stamps of odometry in s."""

    text: str  # empty while the base follows
    # The sign of the demanded motion if the base is blocked; else 0.
    blocked: float
    # How pose and twist contradict each other; empty while they agree.
    contradiction: str
    _demanded_way: float
    _moved_way: float
    _most_demanded: float  # m/s or rad/s; rises from zero after a reversal
    _pose_way: float
    _twist_way: float
    _path: float  # like the greater of both ways, without the signs
    _jumps: float
    _tolerance: float  # m or rad by which the ways may differ
    _least: float  # the slowest command that counts
    _acceleration: float  # of the slow base
    _unit: str
    # The commands from `_first` to before `_end`: the stamp since which each holds, its speed. The
    # slow base moves towards the command at `_held`.
    _stamps: Doubles
    _speeds: Doubles
    _first: int
    _held: int
    _end: int
    _slow_speed: float  # the speed of the slow base
    _command: float  # the last command
    _begun_at: float  # when the comparison began
    # The time since which the speed is outside the bounds (inf: it is within), and the readings
    # since then.
    _outside_since: float
    _outside_readings: int

    def __init__(self, least: float, acceleration: float, unit: str, tolerance: float) -> None:
        self._least = least
        self._acceleration = acceleration
        self._unit = unit
        self._tolerance = tolerance
        self._stamps = doubles(_COMMANDS)
        self._speeds = doubles(_COMMANDS)
        self.reset(0.0, -math.inf)

    def check_indices(self) -> None:
        """ValueError unless its commands are in its buffers, for a serialised robot."""
        if not 0 <= self._first <= self._held <= self._end <= len(self._stamps):
            places = self._first, self._held, self._end
            raise ValueError(f"commands at {places} in {len(self._stamps)} stamps")

    def reset(self, command: float, stamp: float) -> None:
        """Begin again; for WINDOW s, the base may have any speed."""
        self._first = 0
        self._held = 0
        self._end = 0
        self._slow_speed = command
        self._command = command
        self._add(command, stamp)
        self._begun_at = stamp
        self._demanded_way = 0.0
        self._moved_way = 0.0
        self.blocked = 0.0
        self._most_demanded = _inf
        self._pose_way = 0.0
        self._twist_way = 0.0
        self._path = 0.0
        self._jumps = 0.0
        self.contradiction = ""
        self._follow()

    def on_command(self, command: float, stamp: float) -> None:
        """Take in a command, which holds from the reading at `stamp` on."""
        if command != self._command:
            self._command = command
            self._add(command, stamp)

    def _add(self, command: float, stamp: float) -> None:
        """Append a command; if the buffer is full, first move the commands to its begin.

        If the commands fill more than half of the buffer, a larger buffer is made.
        """
        first = self._first
        count = self._end - first
        if self._end == len(self._stamps):
            stamps = self._stamps
            speeds = self._speeds
            if 2 * count > len(self._stamps):
                self._stamps = doubles(4 * count)
                self._speeds = doubles(4 * count)
            for i in range(count):
                self._stamps[i] = stamps[first + i]
                self._speeds[i] = speeds[first + i]
            self._first = 0
            self._held = self._held - first
            self._end = count
        self._stamps[self._end] = stamp
        self._speeds[self._end] = command
        self._end += 1

    def _move_slow_base(self, period: float, stamp: float) -> None:
        """Move the slow base on for `period` s, and drop commands that count no more.

        The slow base follows a command DELAY s late, and two periods are added to this delay. A
        command has the stamp of the last reading before the command, so the stamp is up to a period
        too early. The speed by a reading is the mean over the last period, so the motion began a
        period before the reading.
        """
        # 1. The command that the slow base follows now. If the period has grown, `response` may be
        # earlier than before, so the search goes back, too.
        response = stamp - DELAY - 2.0 * period
        while self._held + 1 < self._end and self._stamps[self._held + 1] <= response:
            self._held += 1
        while self._held > self._first and self._stamps[self._held] > response:
            self._held -= 1
        # 2. Drops commands that ended before the window, up to the command of the slow base.
        while self._held > self._first and self._stamps[self._first + 1] <= stamp - WINDOW:
            self._first += 1
        # 3. The speed changes towards this command, by at most `step`.
        step = self._acceleration * period
        change = self._speeds[self._held] - self._slow_speed
        if change < -step:
            self._slow_speed += -step
        else:
            self._slow_speed += step if change > step else change

    def _follow(self) -> None:
        """Note that the speed is within the bounds: `text` becomes empty."""
        self._outside_since = _inf
        self._outside_readings = 0
        self.text = ""

    def _sum_ways(self, period: float, by_twist: float, by_pose: float) -> None:
        """Add a period to the demanded and the moved way, and set `blocked`; see `on_reading`."""
        slow = self._slow_speed
        sign = copysign(1.0, slow)
        # Of the two measured speeds, the one that is further in the demanded direction.
        moved = sign * max(sign * by_twist, sign * by_pose)
        self._most_demanded += self._acceleration * period
        if sign * self._command < 0.0 or sign * moved < -self._least:
            self._most_demanded = 0.0
        demanded = sign * min(fabs(slow), fabs(self._command), self._most_demanded)
        kept = 1.0 - period / BLOCKED_TIME
        self._demanded_way = kept * self._demanded_way + period * demanded
        # Motion against the demanded direction ends a command before, faster than the slow base.
        counts = demanded * moved > 0.0
        self._moved_way = kept * self._moved_way + (period * moved if counts else 0.0)
        sign = copysign(1.0, self._demanded_way)
        needed = _BLOCKED_SHARE * fabs(self._demanded_way)
        is_demanded = needed >= _BLOCKED_SHARE * _LEAST_WAY
        # A base that is pushed back is not blocked: it does not stand.
        stands = fabs(moved) < self._least and fabs(self._moved_way) < needed
        self.blocked = sign if is_demanded and stands else 0.0

    def _compare_ways(self, period: float, by_twist: float, by_pose: float) -> None:
        """Add a period to the ways by pose and twist, and set `contradiction`; see `on_reading`.

        A jump of the pose is counted, and is no part of the ways.
        """
        twist_step = period * by_twist
        pose_step = period * by_pose
        kept = 1.0 - period / AGREE_TIME
        jump = self._tolerance * (1.0 + _BEYOND * period * period)
        self._jumps *= 1.0 - period / _JUMP_TIME
        if fabs(pose_step) > jump + fabs(twist_step):
            self._jumps += 1.0
            pose_step = twist_step
        self._pose_way = kept * self._pose_way + pose_step
        self._twist_way = kept * self._twist_way + twist_step
        self._path = kept * self._path + max(fabs(pose_step), fabs(twist_step))
        self.contradiction = ""
        if fabs(self._pose_way - self._twist_way) > self._tolerance + _AGREE_SHARE * self._path:
            self.contradiction = (
                f"odometry contradicts itself: by its pose {self._pose_way:.2f}, by its twist"
                f" {self._twist_way:.2f} {self._unit.replace('/s', '')} in the last"
                f" {AGREE_TIME:.0f} s: {_WRONG}"
            )
        elif self._jumps > _JUMPS:
            self.contradiction = (
                f"odometry contradicts itself: its pose jumps by more than {self._tolerance:.2f}"
                f" {self._unit.replace('/s', '')}, its twist does not, in the last"
                f" {_JUMP_TIME:.0f} s: {_WRONG}"
            )

    def on_reading(self, period: float, stamp: float, by_twist: float, by_pose: float) -> None:
        """Compare the speed of the last period with the bounds; set `text` and `contradiction`.

        The text tells how the base differs, once the base has not followed for MIN_DURATION. The
        text is empty while the base follows. The bounds are the speeds of a slow base, which
        responds late and accelerates slowly, and of a fast base, which responds at once to any
        command of the last WINDOW s. Twist and pose each give a measured speed. The base follows if
        either speed is within the bounds.

        Args:
            period: s since the reading before.
            stamp: s, of this reading.
            by_twist: m/s or rad/s, the speed by the measured twist.
            by_pose: m/s or rad/s, the speed by the change of the pose.
        """

        self._compare_ways(period, by_twist, by_pose)
        # 1. The usual case, decided fast: the speed is between the last command and the slow base.
        self._move_slow_base(period, stamp)
        if stamp - self._begun_at >= WINDOW:
            self._sum_ways(period, by_twist, by_pose)
        low = self._slow_speed
        high = self._command
        least = self._least
        if low > high:
            low, high = high, low
        if low - least <= by_twist <= high + least or low - least <= by_pose <= high + least:
            self._follow()
            return

        # 2. The bounds: the slow base, and all commands of the last WINDOW (the fast base). Of the
        # two measured speeds, the speed nearer to the bounds counts.
        low = self._slow_speed
        high = self._slow_speed
        for i in range(self._first, self._end):
            low = min(self._speeds[i], low)
            high = max(self._speeds[i], high)
        tolerance = max(least, SLIP * max(fabs(low), fabs(high)))
        pose_off = max(low - by_pose, by_pose - high)
        twist_off = max(low - by_twist, by_twist - high)
        measured = by_pose if pose_off < twist_off else by_twist
        is_outside = not low - tolerance <= measured <= high + tolerance
        # In the first WINDOW s the base may follow commands from before the comparison.
        if not is_outside or stamp - self._begun_at < WINDOW:
            self._follow()
            return

        # 3. The base does not follow once the speed stays outside the bounds.
        self._outside_since = min(self._outside_since, stamp - period)
        self._outside_readings += 1
        duration = stamp - self._outside_since
        if duration >= MIN_DURATION - 1e-9 and self._outside_readings >= _MIN_READINGS:
            moves = f"{measured:.2f} {self._unit}"
            self.text = (
                f"the base does not follow: commanded {self._command:.2f} {self._unit}, moves"
                f" {moves} since {duration:.1f} s: {_WHY}"
            )


@cython.cclass
class FollowingMonitor:
    """Watches whether the base of one robot follows its safe commands while the robot runs.

    Watched are the forward speed, the turn, and the sideways speed of a base that can slide
    (`limits.lateral`). `text`: how the base differs from its commands, or how odometry contradicts
    itself on these axes; empty if neither. `blocked_bearing`: the direction in rad in which the
    base is blocked, ahead before sideways; NaN: none.
    """

    text: str
    blocked_bearing: float
    _linear: _Axis
    _angular: _Axis
    _lateral: _Axis
    _is_lateral: bool
    # Jumps of the pose that no base can make, faded over _JUMP_TIME, and the last one in m and rad.
    _far_jumps: float
    _far_way: float
    _far_turn: float
    _command: Twist  # the last safe command
    _has_last: bool  # a reading has come since the reset
    # Stamp and pose of the last reading.
    _stamp: float
    _x: float
    _y: float
    _yaw: float

    def __init__(self, platform: Platform) -> None:
        braking = _BRAKING
        given = platform.protection.get("barrier")
        if given is not None:
            settings = msgspec.convert(given, BarrierSettings)
            braking = settings.braking_linear, settings.braking_angular
        linear, angular = (_SLOW * rate for rate in braking)
        self._linear = _Axis(_LEAST[0], linear, _UNITS[0], _TOLERANCES[0])
        self._angular = _Axis(_LEAST[1], angular, _UNITS[1], _TOLERANCES[1])
        self._lateral = _Axis(_LEAST[2], linear, _UNITS[2], _TOLERANCES[2])
        self._is_lateral = platform.limits.lateral > 0.0
        self._command = ZERO
        self.text = ""
        self.blocked_bearing = NAN

    def reset(self) -> None:
        """Drop the last command and reading, as when the robot stops running."""
        if self._has_last:
            self._has_last = False
            self._command = ZERO
            self.text = ""
            self._far_jumps = 0.0
            self.blocked_bearing = NAN

    def on_command(self, command: Twist) -> None:
        """Take in the safe command that the driver gets."""
        if command is self._command:
            return
        self._command = command
        if self._has_last:
            self._linear.on_command(command.linear, self._stamp)
            self._angular.on_command(command.angular, self._stamp)
            if self._is_lateral:
                self._lateral.on_command(command.lateral, self._stamp)

    def on_odometry(self, odometry: Odometry) -> None:
        """Take in a reading: compare the motion since the reading before, and set `text`.

        After a gap in the readings or a jump of the pose that no base can make, the comparison
        begins again. A reading with the stamp of the reading before is ignored.
        """
        pose = odometry.pose
        twist = odometry.twist
        stamp = odometry.stamp
        x = pose.x
        y = pose.y
        yaw = pose.yaw
        had_last = self._has_last
        period = stamp - self._stamp
        dx = x - self._x
        dy = y - self._y
        turned = remainder(yaw - self._yaw, TURN)
        middle_yaw = self._yaw + 0.5 * turned
        if had_last and period == 0.0:
            return
        self._has_last = True
        self._stamp = stamp
        self._x = x
        self._y = y
        self._yaw = yaw
        # 1. Begins again after a gap in the readings, or a jump of the pose.
        way = sqrt(dx * dx + dy * dy)
        is_jump = (  # an estimator corrected the pose, or it was reset
            had_last and max(way, fabs(turned)) > _max_step + _max_speed * max(period, 0.0)
        )
        self._far_jumps *= max(1.0 - max(period, 0.0) / _JUMP_TIME, 0.0) if had_last else 0.0
        if is_jump:
            self._far_jumps += 1.0
            self._far_way = way
            self._far_turn = turned
        if not had_last or not 0.0 < period <= _MAX_PERIOD or is_jump:
            self._linear.reset(self._command.linear, stamp)
            self._angular.reset(self._command.angular, stamp)
            if self._is_lateral:
                self._lateral.reset(self._command.lateral, stamp)
            self.text = self._jump_text()
            self.blocked_bearing = NAN
            return

        # 2. Compares each axis. Speeds by the pose are in the direction of the mean yaw.
        cos_yaw = cos(middle_yaw)
        sin_yaw = sin(middle_yaw)
        self._linear.on_reading(period, stamp, twist.linear, (cos_yaw * dx + sin_yaw * dy) / period)
        self._angular.on_reading(period, stamp, twist.angular, turned / period)
        self.text = self._linear.text or self._angular.text  # the first axis that does not follow
        if self._is_lateral:
            lateral_m = cos_yaw * dy - sin_yaw * dx
            self._lateral.on_reading(period, stamp, twist.lateral, lateral_m / period)
            self.text = self.text or self._lateral.text
        self.text = (
            self.text
            or self._linear.contradiction
            or self._angular.contradiction
            or self._lateral.contradiction
            or self._jump_text()
        )
        self.blocked_bearing = NAN
        if self._linear.blocked:
            self.blocked_bearing = 0.0 if self._linear.blocked > 0.0 else 0.5 * TURN
        elif self._lateral.blocked:
            self.blocked_bearing = 0.25 * TURN * self._lateral.blocked

    def _jump_text(self) -> str:
        """How far the pose jumps, if it does so again and again; empty otherwise."""
        if self._far_jumps <= _JUMPS:
            return ""
        return (
            f"odometry contradicts itself: its pose jumps again and again, last by"
            f" {self._far_way:.2f} m and {self._far_turn:.2f} rad: no base moves so far; it is"
            " reset, or an estimator corrects it, or two publish it"
        )
