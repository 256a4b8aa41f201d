"""Walls that stand: the surfaces of which mode `barrier` assumes that they do not move.

An operator may declare that long, straight surfaces which have stood still do not begin to move
(`walls_stand`). This file decides with each scan which returns are on such a surface. All other
returns are assumed to approach at `others_speed`, as without the declaration.

1. straight_runs.py makes the straight runs of the returns near the lidar.
2. A run of at least `length` m is compared with the walls of the scan before. A wall is a line in
   the odometry frame with bins along it. The line is measured anew each `seconds`. The run
   continues a wall if the run lies on this line, within STILL m and the error of odometry since the
   line was measured. Each bin stores since when all scans have covered the bin. A bin that the run
   does not cover loses this time.
3. A return of the run stands if its bin, or a bin beside it, has been covered for `seconds`.
4. A wall that no run continues in one scan is kept with its times, unless a run shows the wall
   elsewhere: while a robot turns fast, or sees a wall at a grazing angle, single scans split the
   run. No return of the wall stands in such a scan.

So a surface does not stand in a scan in which it is new, hidden, shorter than `length`, curved,
nearer or farther than expected, or misplaced by wrong odometry.

Part of the unit of barrier.py. Units: m, s, rad, in the base frame at the time of the newest
ray, except for walls, which are in the odometry frame.
"""

from __future__ import annotations

from swarmd.core import cython_shadow as cython
from swarmd.core.buffers import doubles, indices
from swarmd.core.cython_shadow import INFINITY, Doubles, Table, cos, fabs, floor, hypot, sin
from swarmd.core.values import Platform
from swarmd.robot.protection.barrier_assumptions import OTHER, WALL
from swarmd.robot.protection.dead_reckoning import ScanMotion
from swarmd.robot.protection.decision import MovedWall
from swarmd.robot.protection.obstacles import ReturnLayer
from swarmd.robot.protection.settings import ODOMETRY_SHARE
from swarmd.robot.protection.walls.bare_returns import BareReturns
from swarmd.robot.protection.walls.straight_runs import SPACING, Run, StraightRuns
from swarmd.robot.protection.walls.walls_settings import STILL, WallsStand

_odometry_share = ODOMETRY_SHARE
_still = STILL
# Periods between two scans: after more, a revolution of the lidar was lost.
_LATE_TURN = 1.6
_MISSED = 1  # scans in a row that need not show a wall
_BIN = 0.04  # m along a wall
_BINS = 128  # of a wall
_WALLS = 16  # the most walls
_PARALLEL = 0.3  # sine of the angle by which a wall may have turned
_FASTEST_WALL = 1.0  # m/s at which a moving wall is recognised
_SHOWN_TWICE = 2  # scans in a row that show a wall elsewhere
# m, beyond the error of odometry, by which rays must pass through the old place of a wall. Lines of
# robots that turned among walls at rest were up to 9 cm off in two scans in a row.
_MOVED = 0.1
_EDGE = 2  # covered bins on both sides of a ray through a wall
_AT_REST = 1e-3  # m and rad by odometry


@cython.cclass
class Wall:
    """A wall: a line in the odometry frame, with bins along it."""

    x: float  # the middle of its bins, in the odometry frame
    y: float
    ux: float  # its direction, in the odometry frame
    uy: float
    here_x: float  # the same in the base frame of the present scan
    here_y: float
    here_ux: float
    here_uy: float
    measured_at: float  # the time at which its line was measured
    way: float  # `_way` at that time
    turn: float  # `_turn` at that time
    since: float  # the time since which it stands
    confirmed: float  # the time at which it was last confirmed
    off: float  # m by which its line then was off
    is_seen: bool  # a run of this scan continues it
    moves: int  # scans in a row that showed it elsewhere
    low: int  # its first covered bin
    high: int  # its last covered bin
    missed: int  # scans in a row that have not shown it
    # For each bin: since when it is covered, and the same after this scan; inf: not.
    bins: Doubles
    next_bins: Doubles

    def __init__(self) -> None:
        self.bins = doubles(_BINS)
        self.next_bins = doubles(_BINS)


def _bin_at(wall: Wall, run: Run, along: float) -> int:
    """The bin of a wall beside the place `along` m on a run; -2 or _BINS: beyond the bins."""
    dx = run.x + along * run.ux - wall.here_x
    dy = run.y + along * run.uy - wall.here_y
    place = wall.here_ux * dx + wall.here_uy * dy
    place = place / _BIN + 0.5 * _BINS
    if place >= _BINS:
        return _BINS
    return cython.cast(cython.Py_ssize_t, floor(place)) if place >= -2.0 else -2


@cython.cclass
class StandingWalls(ReturnLayer):
    """The walls around one robot that have stood still, and the returns of a scan on them."""

    is_trusted: bool  # False: no return stands, since a wall was found to move
    moved: MovedWall | None  # MovedWall: what the last scan showed; None without a wall that moved
    _length: float
    _seconds: float
    _period: float  # s of a revolution of the lidar
    _runs: StraightRuns  # of the last scan
    _bare: BareReturns | None  # None: `walls_stand` has no `foot`
    _walls: list[Wall]  # _WALLS, of which the first `_wall_count` are in use
    _wall_count: int
    # What `_overlap` has found: the ends of the part of a run beside a wall in m along the run, and
    # how far the line of the wall is from the run at both ends in m.
    _overlap_first: float
    _overlap_last: float
    _off_first: float
    _off_last: float
    # The sum of all motion by odometry since the start: m driven, rad turned.
    _way: float
    _turn: float
    _resets: int

    def __init__(self, platform: Platform, walls_stand: WallsStand, extent: float) -> None:
        """`extent`: m, the `unseen_extent` of the platform."""
        ReturnLayer.__init__(self, len(platform.scan.bearings))
        self._length = walls_stand.length
        self._seconds = walls_stand.seconds
        self._period = 1.0 / platform.scan.rate
        self.is_trusted = True
        has_foot = walls_stand.foot is not None
        self._runs = StraightRuns(platform, walls_stand.length, bridges=has_foot)
        self.wants_all = has_foot
        if has_foot:
            self._bare = BareReturns(platform, walls_stand.length, extent)
        self._walls = [Wall() for _ in range(_WALLS)]
        self.forget()

    def hear(self, diagonal: float) -> None:
        """Take in the longest diagonal in m of the platforms of all peers; inf: not known."""
        if self._bare is not None:
            self._bare.longest_heard = diagonal

    def forget(self) -> None:
        """Forget all walls: each must stand anew."""
        self._wall_count = 0

    def observe(
        self,
        ranges: Doubles,
        directions: Doubles,
        ages: Doubles,
        filled: Doubles,
        borrowed: int,
        hidden: Table,
        motion: ScanMotion,
    ) -> None:
        """Take in a scan, and set `moved` if it shows a moved wall."""
        count = len(ranges)
        if len(self.kinds) < count:
            self.kinds = indices(count)
        for i in range(count):
            self.kinds[i] = OTHER
        self.has_kinds = False
        self._way += hypot(motion.moved.x, motion.moved.y)
        self._turn += fabs(motion.moved.yaw)
        # No wall can be compared after a lost revolution of the lidar, or after a reset of
        # odometry, whose new frame has no relation to the frame of the walls: forgets all walls.
        if self._resets != motion.resets or not motion.seconds <= _LATE_TURN * self._period:
            self.forget()
        self._resets = motion.resets
        self._runs.find(ranges, directions, ages)
        self._compare(motion)
        self.has_kinds = self.has_kinds and self.is_trusted
        bare: BareReturns | None = self._bare
        self.has_bare_walls = False
        if bare is not None and self.has_kinds:
            self.has_bare_walls = bare.mark(
                self.kinds, self._runs, ranges, directions, ages, filled, borrowed, hidden
            )

    def _compare(self, motion: ScanMotion) -> None:
        """Find by the runs which walls stand, have moved, are gone or are new."""
        self._place_walls(motion)
        # 1. Walls that a run continues: first the long runs, whose returns may stand.
        for j in range(self._runs.count):
            run: Run = self._runs.runs[j]
            if run.is_long:
                self._match(run, True, motion)
        # 2. Then the short runs that meet a long run at a corner, such as the posts of a door. The
        # returns of such a run may stand if the return of the long run at the corner stands.
        for j in range(self._runs.count):
            run = self._runs.runs[j]
            if not run.is_long:
                corner = self._runs.corner_of(j)
                if corner >= 0:
                    is_on_wall = self.kinds[self._runs.ray[corner]] == WALL
                    self._match(run, is_on_wall, motion)
        # 3. Walls that are elsewhere now, and walls that no run has continued for too long.
        self._find_moved(motion)
        self._drop_walls()
        # 4. New walls, of the runs that continue no wall.
        for j in range(self._runs.count):
            run = self._runs.runs[j]
            if run.owner >= 0 or self._wall_count == _WALLS:
                continue
            if run.is_long or self._runs.corner_of(j) >= 0:
                self._add_wall(run, motion)

    def _match(self, run: Run, is_on_wall: bool, motion: ScanMotion) -> None:
        """Continue the first wall on whose line a run lies.

        A wall that the scan before showed elsewhere is left out. `is_on_wall`: the returns of the
        run may stand (see `_continue`).
        """
        for i in range(self._wall_count):
            wall: Wall = self._walls[i]
            if not wall.moves and self._is_still(wall, run):
                self._continue(wall, run, is_on_wall, motion)
                run.owner = i
                break

    def _place_walls(self, motion: ScanMotion) -> None:
        """Place the walls in the base frame of the scan; none of their bins is covered yet."""
        c = cos(motion.pose.yaw)
        s = sin(motion.pose.yaw)
        for i in range(self._wall_count):
            wall: Wall = self._walls[i]
            self._centre_bins(wall)
            dx = wall.x - motion.pose.x
            dy = wall.y - motion.pose.y
            wall.here_x = c * dx + s * dy
            wall.here_y = c * dy - s * dx
            dx = wall.ux
            dy = wall.uy
            wall.here_ux = c * dx + s * dy
            wall.here_uy = c * dy - s * dx
            wall.is_seen = False
            for k in range(_BINS):
                wall.next_bins[k] = INFINITY

    def _centre_bins(self, wall: Wall) -> None:
        """Move the bins of a wall along its line if the covered bins are far off the middle.

        Far off is more than an eighth of all bins. If the bins were not moved, the end of a wall
        along which the robot drives would soon lie beyond the last bin.
        """
        off_middle = 0.5 * (wall.low + wall.high - _BINS)
        shift = cython.cast(cython.Py_ssize_t, floor(off_middle))
        if -(_BINS // 8) <= shift <= _BINS // 8:
            return
        wall.bins, wall.next_bins = wall.next_bins, wall.bins  # `_place_walls` clears `next_bins`
        for k in range(_BINS):
            is_inside = 0 <= k + shift < _BINS
            wall.bins[k] = wall.next_bins[k + shift] if is_inside else INFINITY
        wall.low -= shift
        wall.high -= shift
        wall.x += _BIN * shift * wall.ux
        wall.y += _BIN * shift * wall.uy

    def _overlap(self, wall: Wall, run: Run) -> bool:
        """Find the part of a run beside the covered bins of a wall; False without such a part.

        Sets `_overlap_first` and `_overlap_last`, the ends of the part, and `_off_first` and
        `_off_last`, how far the line of the wall is from the run at both ends.
        """
        ux = wall.here_ux
        uy = wall.here_uy
        cosine = ux * run.ux + uy * run.uy
        sine = ux * run.uy - uy * run.ux
        if not fabs(sine) <= _PARALLEL:
            return False
        # 1. The ends of the covered bins in m along the run, cut off at the ends of the run.
        dx = wall.here_x - run.x
        dy = wall.here_y - run.y
        middle = dx * run.ux + dy * run.uy
        direction = 1.0 if cosine >= 0.0 else -1.0
        low = _BIN * (wall.low - 0.5 * _BINS)
        high = _BIN * (wall.high + 1.0 - 0.5 * _BINS)
        first = middle + direction * (low if direction > 0.0 else high)
        last = middle + direction * (high if direction > 0.0 else low)
        first = first if first > run.begin else run.begin
        last = last if last < run.end else run.end
        if not last > first:
            return False
        # 2. How far the line is from the point of the run at 0 m. The distance changes along the
        # run by the sine of the angle between run and line.
        off = uy * dx - ux * dy
        self._overlap_first = first
        self._overlap_last = last
        self._off_first = off + sine * first
        self._off_last = off + sine * last
        return True

    def _is_still(self, wall: Wall, run: Run) -> bool:
        """True if a run is where a wall was when its line was measured.

        Each end of their overlap may be off by STILL plus the error of odometry since then.
        """
        if not self._overlap(wall, run):
            return False
        if not fabs(self._off_first) <= _still + self._odometry_error(
            wall, run, self._overlap_first
        ):
            return False
        return fabs(self._off_last) <= _still + self._odometry_error(wall, run, self._overlap_last)

    def _odometry_error(self, wall: Wall, run: Run, along: float) -> float:
        """The error of odometry in m since the line of a wall was measured.

        The error is that of the place `along` m on a run: the farther the place is from the robot,
        the more an error of the turn moves the place.
        """
        way = self._way - wall.way
        turn = self._turn - wall.turn
        x = run.x + along * run.ux
        y = run.y + along * run.uy
        return _odometry_share * (way + turn * hypot(x, y))

    def _continue(self, wall: Wall, run: Run, is_on_wall: bool, motion: ScanMotion) -> None:
        """Cover the bins of a wall that a run shows, and mark the returns of the run that stand.

        No return is marked unless `is_on_wall`: the run is long, or meets a standing return of a
        long run at a corner.
        """
        now = motion.measured_at
        self._cover_bins(wall, run, now)
        if is_on_wall:
            self._mark_standing(wall, run, now)
        # 1. Confirms the wall: the mean distance of the line from the run, and the time.
        has_overlap = self._overlap(wall, run) != 0
        wall.off = 0.5 * (self._off_first + self._off_last) if has_overlap else 0.0
        wall.is_seen = True
        wall.confirmed = now
        # 2. Measures the line anew each `_seconds`.
        if now - wall.measured_at >= self._seconds:
            self._move_line(wall, run, motion)
            wall.off = 0.0

    def _cover_bins(self, wall: Wall, run: Run, now: float) -> None:
        """Cover the bins of a wall between returns of a run that are at most SPACING apart."""
        count = run.length + 1
        before = -INFINITY  # m along the run, of the return before
        for k in range(count):
            along = self._runs.along(run, k)
            is_on_line = along == along  # NaN for a return off the line
            if is_on_line:
                is_near = fabs(along - before) <= SPACING
                self._cover(wall, run, before if is_near else along, along, now)
                before = along

    def _mark_standing(self, wall: Wall, run: Run, now: float) -> None:
        """Mark the returns of a run in bins of a wall that have stood, or beside such a bin.

        Sets `kinds` and `has_kinds`.
        """
        count = run.length + 1
        for k in range(count):
            along = self._runs.along(run, k)
            is_on_line = along == along  # NaN for a return off the line
            if not is_on_line:
                continue
            place = self._runs.return_of(run, k)
            bin_of_wall = _bin_at(wall, run, along)
            if self._has_stood(wall, bin_of_wall, now):
                self.kinds[self._runs.ray[place]] = WALL
                self.has_kinds = True

    def _move_line(self, wall: Wall, run: Run, motion: ScanMotion) -> None:
        """Move the line of a wall to that of a run; the bins keep their places."""
        dx = wall.here_x - run.x
        dy = wall.here_y - run.y
        middle = run.ux * dx + run.uy * dy
        cosine = wall.here_ux * run.ux + wall.here_uy * run.uy
        self._set_line(wall, run, middle, 1.0 if cosine >= 0.0 else -1.0, motion)

    def _cover(self, wall: Wall, run: Run, begin: float, end: float, now: float) -> None:
        """Cover the bins between two places of a run; bins that were covered keep their time.

        `begin`, `end`: m along the run.
        """
        low = _bin_at(wall, run, begin)
        high = _bin_at(wall, run, end)
        if low > high:
            low, high = high, low
        for k in range(low if low > 0 else 0, high + 1 if high < _BINS else _BINS):
            since = wall.bins[k]
            wall.next_bins[k] = since if since < INFINITY else now

    def _has_stood(self, wall: Wall, bin_of_wall: int, now: float) -> bool:
        """True if a bin, or a bin beside it, has been covered for `_seconds`, this scan included.

        The bins beside count, since the visible end of a wall changes from scan to scan with the
        last ray that meets the wall.
        """
        for k in range(bin_of_wall - 1, bin_of_wall + 2):
            if 0 <= k < _BINS and now - wall.next_bins[k] >= self._seconds:
                return True
        return False

    def _set_line(
        self, wall: Wall, run: Run, along: float, direction: float, motion: ScanMotion
    ) -> None:
        """Set the line of a wall to that of a run, in the odometry frame.

        `along`: m along the run, where the middle of the bins is. `direction`: 1 if the wall has
        the direction of the run, -1 if the wall has the opposite direction.
        """
        c = cos(motion.pose.yaw)
        s = sin(motion.pose.yaw)
        ux = run.ux
        uy = run.uy
        x = run.x + along * ux
        y = run.y + along * uy
        wall.x = motion.pose.x + c * x - s * y
        wall.y = motion.pose.y + s * x + c * y
        wall.ux = direction * (c * ux - s * uy)
        wall.uy = direction * (s * ux + c * uy)
        wall.measured_at = motion.measured_at
        wall.way = self._way
        wall.turn = self._turn

    def _drop_walls(self) -> None:
        """Drop the walls that more than _MISSED scans in a row have not shown."""
        kept = 0
        for i in range(self._wall_count):
            wall: Wall = self._walls[i]
            if wall.is_seen:
                wall.missed = 0
                self._keep_covered(wall)
            elif wall.moves:
                # The wall is elsewhere. The next scan must show the wall, else the wall is dropped.
                wall.missed = _MISSED
            else:
                wall.missed += 1
            if wall.missed <= _MISSED:  # takes the place of a wall that is dropped
                self._walls[i] = self._walls[kept]
                self._walls[kept] = wall
                kept += 1
        self._wall_count = kept

    def _keep_covered(self, wall: Wall) -> None:
        """Keep the bins of a wall that this scan covers, and find the first and the last one."""
        wall.bins, wall.next_bins = wall.next_bins, wall.bins
        wall.low = _BINS
        wall.high = -1
        for k in range(_BINS):
            if wall.bins[k] < INFINITY:
                wall.high = k
                if wall.low == _BINS:
                    wall.low = k

    def _add_wall(self, run: Run, motion: ScanMotion) -> None:
        """Add a wall whose bins have been covered since this scan."""
        wall: Wall = self._walls[self._wall_count]
        half = 0.5 * (run.end - run.begin)
        bins = floor(half / _BIN) + 1.0
        covered = _BINS // 2  # on each side of the middle
        if bins <= covered:
            covered = cython.cast(cython.Py_ssize_t, bins)
        self._set_line(wall, run, run.begin + half, 1.0, motion)
        wall.since = motion.measured_at
        wall.confirmed = motion.measured_at
        wall.is_seen = True
        wall.off = 0.0
        wall.moves = 0
        wall.missed = 0
        wall.low = _BINS // 2 - covered
        wall.high = _BINS // 2 + covered - 1
        for k in range(_BINS):
            wall.bins[k] = motion.measured_at if wall.low <= k <= wall.high else INFINITY
        self._wall_count += 1

    def _find_moved(self, motion: ScanMotion) -> None:
        """Set `moved` if a wall that had stood is elsewhere, in this scan and in the scan before.

        A wall that two scans in a row have shown elsewhere is not examined again. `motion`: of the
        present scan.
        """
        for i in range(self._wall_count):
            wall: Wall = self._walls[i]
            # 1. Scans in a row before this scan that showed the wall elsewhere. The count begins
            # anew unless this scan shows the wall elsewhere, too.
            scans_elsewhere = wall.moves
            wall.moves = 0
            was_examined = scans_elsewhere >= _SHOWN_TWICE
            if wall.is_seen or was_examined:
                continue
            seconds = motion.measured_at - wall.confirmed
            if not seconds > 0.0 or not self._may_judge(wall):
                continue
            # 2. The wall is elsewhere if a run lies within the m that a wall can have moved.
            farthest = _still + _FASTEST_WALL * seconds
            was_elsewhere = scans_elsewhere > 0
            is_elsewhere = self._moved_by(wall, was_elsewhere, farthest) < farthest
            if not is_elsewhere:
                continue
            # 3. The wall has moved if the scan before showed the wall elsewhere, too, and rays pass
            # through its old place to a run that was no wall before.
            wall.moves = scans_elsewhere + 1
            if wall.moves < _SHOWN_TWICE:
                continue
            distance = self._moved_away_by(wall, farthest)
            if distance < farthest:
                stood = wall.confirmed - wall.since
                self.moved = MovedWall(stood, distance, distance / seconds)

    def _may_judge(self, wall: Wall) -> bool:
        """True if a wall has stood long enough, and odometry is right.

        Wrong odometry shows all walls elsewhere. Odometry is right if a wall stands in this scan,
        or if the robot has not moved by odometry since the line of the wall was measured.
        """
        stood = wall.confirmed - wall.since
        way = self._way - wall.way
        turn = self._turn - wall.turn
        is_robot_at_rest = way <= _AT_REST and turn <= _AT_REST
        is_odometry_right = self.has_kinds or is_robot_at_rest
        may_judge = stood >= self._seconds and is_odometry_right
        return may_judge

    def _moved_by(self, wall: Wall, was_elsewhere: bool, farthest: float) -> float:
        """The m from the line of a wall to the nearest run that may show the wall elsewhere.

        The result is `farthest` in m if no such run is nearer. A run that continues a wall is
        examined only if `was_elsewhere`: the scan before showed the wall elsewhere, perhaps as a
        new wall.
        """
        least = farthest
        for j in range(self._runs.count):
            run: Run = self._runs.runs[j]
            if run.owner >= 0 and not was_elsewhere:
                continue
            off = self._distance(wall, run)
            if off < least:
                least = off
        return least

    def _moved_away_by(self, wall: Wall, farthest: float) -> float:
        """As `_moved_by`, of the runs that are seen through the old place of the wall.

        A run that continues a wall which was there when `wall` was last confirmed is that other
        wall, and shows nothing. A wall that has come nearer hides its old place.
        """
        least = farthest
        for j in range(self._runs.count):
            run: Run = self._runs.runs[j]
            is_known = False
            if run.owner >= 0:
                other: Wall = self._walls[run.owner]
                is_known = other.since <= wall.confirmed
            off = self._distance(wall, run)
            if not is_known and off < least and self._is_seen_through(wall, run):
                least = off
        return least

    def _distance(self, wall: Wall, run: Run) -> float:
        """The m from the line of a wall to a run that lies beside it; inf if the run does not.

        The run must lie beside at least half of `length` of the wall, off its line. The distance is
        that of the farther end of this part of the run, less the distance at which the wall was
        last confirmed.
        """
        if not self._overlap(wall, run) or self._is_still(wall, run):
            return INFINITY
        off_before = wall.off
        off = fabs(self._off_first - off_before)
        last_off = fabs(self._off_last - off_before)
        off = last_off if last_off > off else off
        overlap = self._overlap_last - self._overlap_first
        return off if overlap >= 0.5 * self._length else INFINITY

    def _is_seen_through(self, wall: Wall, run: Run) -> bool:
        """True if the rays to a run pass through at least half of `length` of a wall's old place.

        A ray passes through if it crosses the line of the wall among covered bins, and ends at
        least _MOVED m and the error of odometry behind the line.
        """
        count = run.length + 1
        ux = wall.here_ux
        uy = wall.here_uy
        from_x = self._runs.lidar_x - wall.here_x
        from_y = self._runs.lidar_y - wall.here_y
        before = ux * from_y - uy * from_x  # m from the line to the lidar
        least_bin = _BINS
        greatest_bin = -1
        for k in range(count):
            along = self._runs.along(run, k)
            place = self._runs.return_of(run, k)
            x = self._runs.x[place] - wall.here_x
            y = self._runs.y[place] - wall.here_y
            behind = ux * y - uy * x
            is_on_line = along == along  # NaN for a return off the line of the run
            is_other_side = before * behind < 0.0
            if not is_on_line or not is_other_side:
                continue
            if fabs(behind) < _MOVED + self._odometry_error(wall, run, along):
                continue
            share = before / (before - behind)
            cross_x = from_x + share * (x - from_x)
            cross_y = from_y + share * (y - from_y)
            crossing = (ux * cross_x + uy * cross_y) / _BIN + 0.5 * _BINS
            if not _EDGE <= crossing < _BINS - _EDGE:
                continue
            bin_of_wall = cython.cast(cython.Py_ssize_t, floor(crossing))
            is_covered = True
            for b in range(bin_of_wall - _EDGE, bin_of_wall + _EDGE + 1):
                is_covered = is_covered and wall.bins[b] < INFINITY
            if is_covered:
                least_bin = bin_of_wall if bin_of_wall < least_bin else least_bin
                greatest_bin = bin_of_wall if bin_of_wall > greatest_bin else greatest_bin
        return _BIN * (greatest_bin - least_bin) >= 0.5 * self._length
