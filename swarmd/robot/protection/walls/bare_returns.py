"""Bare returns: the returns of walls that stand from which nothing sticks out by more than `foot`.

A return of a wall that stands (kind WALL) becomes a return of the kind BARE_WALL if all conditions
hold in this scan. The numbers are those of the method that tests the condition.

1. `_take_stretch`. The return is of the kind WALL, and a member of a *stretch*: rays of one long
   run that follow each other, each measured in this scan and on the line of the run. Neighbouring
   members are less than _PART m apart: no platform of swarmd is narrower in the scan plane. Rays
   that the scan did not measure may lie between two members, but no ray that ends before or behind
   the line. A stretch has at most _LOST_SECTORS sectors of such rays: a row of legs has more.
2. `_is_flat`, `_take_stretch`. The stretch is at least as long as `length` and as the longest
   diagonal of all platforms heard (`longest_heard`), and bends with a radius of at least
   _FLAT_RADIUS m.
3. `_mark_candidates`. Both neighbour rays are members of the same stretch: no return beside a lost
   ray, or at the end of a stretch, is bare.
4. `_deny_returns`, `_deny_hidden`. Nothing that is not of the run lies within `extent` m
   (`unseen_extent`) of the return: no return at any range, no remembered ray, no return too close
   to measure, no obstacle hidden in the blind zone. Of a return the far side of a head
   counts, too, and its shadow, in which another body may stand. Places that others told are
   compared where the constraints are made (`ToldPlaces`).
5. `_deny_unmeasured`. No sector of rays without a measurement, in which a part of _PART m may stand
   before the wall, lies within `extent` m: lost rays, masks, blind and frozen sectors, black or
   transparent surfaces, open space beside the end of the wall.

Rays that an earlier scan filled, rays of an earlier revolution, and rays that were borrowed from
the scan before were not measured.

Not known here: what lies below or above the scan plane and has no part in it, and a part narrower
than _PART whose returns are lost. docs/walls.md names both.

Part of the unit of barrier.py. Units: m, s, in the base frame at the time of the newest ray.
"""

from __future__ import annotations

from swarmd.core import cython_shadow as cython
from swarmd.core.angles import TURN
from swarmd.core.buffers import doubles, indices
from swarmd.core.cython_shadow import INFINITY, Doubles, Indices, Table, fabs, hypot, sqrt
from swarmd.core.values import Platform
from swarmd.robot.protection.barrier_assumptions import BARE_WALL, WALL
from swarmd.robot.protection.obstacles import REACH
from swarmd.robot.protection.outline import Outline
from swarmd.robot.protection.walls.straight_runs import Run, StraightRuns

# m, the narrowest part of any platform in the scan plane. The lidar heads of TurtleBots have
# diameters of 0.072 and 0.11 m.
_PART = 0.05
_HEAD = 0.11  # m, the diameter of the widest of these heads
_PARALLEL_RAY = 1e-6  # the sine of the angle between ray and line
# Sectors of rays without a measurement within a stretch. Of 150 rays of which 1 % are lost, 98 of
# 100 scans have no more. A row of legs of 12 cm has more along 1 m.
_LOST_SECTORS = 4
# m: a stretch bends with a larger radius. Noise of 1 cm changes 1 / radius of a stretch of 1 m by
# some 0.03 / m (one standard deviation). A tank of 5 m radius has 0.2 / m.
_FLAT_RADIUS = 10.0
_LEAST_MEMBERS = 20  # members of a stretch
# rad: a sector as wide may be open space.
_WIDE_SECTOR = 1.0

# What this scan knows of a ray.
_UNMEASURED = 0
_RETURN = 1
_TOO_CLOSE = 2
_BORROWED = 3  # of the scan before, and not in the order of rays


@cython.cclass
class BareReturns:
    """The bare returns of one scan."""

    longest_heard: float  # m, the longest diagonal of the platforms of all peers
    _length: float  # m, the least length of a stretch
    _extent: float  # m, `unseen_extent`
    _outline: Outline
    _range_min: float
    _lidar_height: float  # m of the lidar above the line of the present run
    _rays: int
    _borrowed: int  # of these, the first ones
    # For each ray.
    _state: Indices  # _UNMEASURED, _RETURN, _TOO_CLOSE or _BORROWED
    _x: Doubles  # m, the place of a finite range, measured or filled
    _y: Doubles
    _hides_from: Doubles  # m from the lidar, of an unmeasured ray: a part may hide there
    _is_open: Indices  # 1: an unmeasured ray of a sector as wide as open space
    _is_member: Indices  # 1: measured, and on the line of the present run
    _along: Doubles  # m along the line of the present run, of a member
    _across: Doubles
    _is_candidate: Indices
    _stretch: Indices  # the members of the present stretch

    def __init__(self, platform: Platform, length: float, extent: float) -> None:
        """`length`: m, the least length of a wall. `extent`: m, the `unseen_extent`."""
        self.longest_heard = 0.0
        self._length = length
        self._extent = extent
        self._outline = Outline(platform)
        self._range_min = platform.scan.range_min
        self._allocate(len(platform.scan.bearings))

    def check_indices(self) -> None:
        """ValueError unless each array has a number for each ray."""
        if len(self._state) < self._rays:
            raise ValueError(f"{self._rays} rays in arrays of {len(self._state)}")
        if not 0 <= self._borrowed <= self._rays:
            raise ValueError(f"{self._borrowed} rays of {self._rays} are borrowed")

    def _allocate(self, rays: int) -> None:
        """Make the arrays anew, for so many rays."""
        self._state = indices(rays)
        self._is_member = indices(rays)
        self._is_candidate = indices(rays)
        self._stretch = indices(rays)
        self._x = doubles(rays)
        self._y = doubles(rays)
        self._along = doubles(rays)
        self._across = doubles(rays)
        self._hides_from = doubles(rays)
        self._is_open = indices(rays)

    def mark(
        self,
        kinds: Indices,
        runs: StraightRuns,
        ranges: Doubles,
        directions: Doubles,
        ages: Doubles,
        filled: Doubles,
        borrowed: int,
        hidden: Table,
    ) -> bool:
        """Change the kind of each bare return from WALL to BARE_WALL; True if there is any.

        `runs`: the straight runs of this scan. The other arguments are those of
        `ReturnLayer.observe`; directions of all rays are set.
        """
        is_any = False
        self._rays = len(ranges)
        self._borrowed = borrowed
        if len(self._state) < self._rays:
            self._allocate(self._rays)
        self._place_rays(ranges, directions, ages, filled, runs.oldest)
        self._find_hiding(directions)
        for j in range(runs.count):
            run: Run = runs.runs[j]
            if not run.is_long:
                continue  # a short run at a corner may be a body
            self._lidar_height = self._height(run, runs, runs.lidar_x, runs.lidar_y)
            self._find_members(run, runs)
            if not self._find_stretches(run, runs, kinds):
                continue
            self._deny_returns(run, runs, directions)
            self._deny_hidden(run, runs, hidden)
            self._deny_unmeasured(run, runs, directions)
            for i in range(self._rays):
                if self._is_candidate[i]:
                    kinds[i] = BARE_WALL
                    is_any = True
        return is_any != 0

    def _place_rays(
        self, ranges: Doubles, directions: Doubles, ages: Doubles, filled: Doubles, oldest: float
    ) -> None:
        """Find what this scan knows of each ray, and the place of each finite range.

        `oldest`: s, the greatest age of a ray of this revolution.
        """
        outline: Outline = self._outline
        for i in range(self._rays):
            distance = ranges[i]
            is_filled = len(filled) > 0 and filled[i] != 0.0
            is_of_revolution = len(ages) == 0 or ages[i] <= oldest
            self._x[i] = outline.lidar_x + distance * directions[2 * i]
            self._y[i] = outline.lidar_y + distance * directions[2 * i + 1]
            if i < self._borrowed:
                self._state[i] = _BORROWED
            elif distance == -INFINITY:
                self._state[i] = _TOO_CLOSE
            elif 0.0 < distance < INFINITY and is_of_revolution and not is_filled:
                self._state[i] = _RETURN
            else:
                self._state[i] = _UNMEASURED

    def _find_hiding(self, directions: Doubles) -> None:
        """Find from which distance on a part may hide along each unmeasured ray.

        A part of _PART m fits between the two measured rays at the edges of a sector from the
        distance on at which these rays are _PART m apart. No part is within the own outline.
        """
        own = self._rays - self._borrowed  # rays of this scan
        first = 0
        while first < own and self._state[self._own_ray(first)] == _UNMEASURED:
            first += 1
        # 1. Each measured ray ends the sector behind the measured ray before; without one, the
        # whole turn is one sector.
        begin = first if first < own else 0
        last = begin
        angle = 0.0 if first < own else INFINITY
        for k in range(begin + 1, begin + own + 1):
            i = self._own_ray(k)
            angle += _between(directions, self._own_ray(k - 1), i)
            if self._state[i] == _UNMEASURED and k < begin + own:
                continue
            self._set_hiding(last, k, angle, directions)
            last = k
            angle = 0.0
        # 2. The borrowed rays are a sector, which is one ray wider than they are.
        if self._borrowed:
            angle = 2.0 * TURN / own if own else INFINITY
            for k in range(1, self._borrowed):
                angle += _between(directions, k - 1, k)
            for k in range(self._borrowed):
                self._hide(k, angle, directions)

    def _own_ray(self, number: int) -> int:
        """The index of a ray of this scan; the first ray follows the last one.

        `number`: from 0 to below twice the rays of this scan.
        """
        own = self._rays - self._borrowed
        return self._borrowed + (number - own if number >= own else number)

    def _set_hiding(self, last: int, end: int, angle: float, directions: Doubles) -> None:
        """Set `_hides_from` of the unmeasured rays of this scan from number `last` to `end`.

        `angle`: rad, the width of the sector.
        """
        for k in range(last, end + 1):
            i = self._own_ray(k)
            if self._state[i] == _UNMEASURED:
                self._hide(i, angle, directions)

    def _hide(self, ray: int, angle: float, directions: Doubles) -> None:
        """Set `_hides_from` of a ray in a sector of `angle` rad."""
        self._is_open[ray] = angle >= _WIDE_SECTOR
        least = _PART / angle if angle > 0.0 else INFINITY
        outline = self._outline.along_ray(directions[2 * ray], directions[2 * ray + 1])
        self._hides_from[ray] = outline if outline > least else least

    def _find_members(self, run: Run, runs: StraightRuns) -> None:
        """Find the rays of this scan that are on the line of a run; no ray is a candidate yet."""
        for i in range(self._rays):
            self._is_member[i] = 0
            self._is_candidate[i] = 0
        for k in range(run.length + 1):
            along = runs.along(run, k)
            ray = runs.ray[runs.return_of(run, k)]
            is_on_line = along == along  # NaN for a return off the line
            if is_on_line and self._state[ray] == _RETURN:
                self._is_member[ray] = 1
                self._along[ray] = along
                self._across[ray] = self._height(run, runs, self._x[ray], self._y[ray])

    def _height(self, run: Run, runs: StraightRuns, x: float, y: float) -> float:
        """m by which a place lies before the line of a run, seen from the lidar; < 0: behind."""
        side = run.ux * (runs.lidar_y - run.y) - run.uy * (runs.lidar_x - run.x)
        height = run.ux * (y - run.y) - run.uy * (x - run.x)
        return height if side >= 0.0 else -height

    def _find_stretches(self, run: Run, runs: StraightRuns, kinds: Indices) -> bool:
        """Find the stretches of a run, and mark their candidates; True if there is a candidate."""
        own = self._rays - self._borrowed
        first = runs.ray[run.first] - self._borrowed
        last = runs.ray[runs.return_of(run, run.length)] - self._borrowed
        # A run that begins or ends with a borrowed ray begins or ends at the first ray.
        first = first if first > 0 else 0
        last = last if last > 0 else 0
        steps = last - first if last >= first else last - first + own
        count = 0  # members of the present stretch
        lost = 0  # sectors of unmeasured rays in it
        is_lost = False  # the ray before was not measured
        is_any = False
        for k in range(steps + 1):
            i = self._own_ray(first + k)
            if self._state[i] == _UNMEASURED:
                is_lost = True
                continue
            is_next = False
            if self._is_member[i] and count:
                before = self._stretch[count - 1]
                spacing = hypot(self._x[i] - self._x[before], self._y[i] - self._y[before])
                is_next = spacing < _PART
            if not is_next:  # ends the stretch before this ray
                if self._take_stretch(count, lost, kinds):
                    is_any = True
                count = 0
                lost = 0
            elif is_lost:
                lost += 1
            is_lost = False
            if self._is_member[i]:
                self._stretch[count] = i
                count += 1
        if self._take_stretch(count, lost, kinds):
            is_any = True
        return is_any != 0

    def _take_stretch(self, count: int, lost: int, kinds: Indices) -> bool:
        """Mark the candidates of the present stretch, if long and flat; True if there are any.

        `count`: its members. `lost`: its sectors of unmeasured rays.
        """
        if count < 1 or lost > _LOST_SECTORS:
            return False
        first = self._stretch[0]
        last = self._stretch[count - 1]
        length = fabs(self._along[last] - self._along[first])
        if not (length >= self._length and length >= self.longest_heard):
            return False
        if not self._is_flat(count):
            return False
        return self._mark_candidates(count, kinds)

    def _is_flat(self, count: int) -> bool:
        """True if the first `count` of `_stretch` bend with a radius of at least _FLAT_RADIUS m.

        A parabola is fitted by least squares, as in `StraightRuns._is_straight`.
        """
        if count < _LEAST_MEMBERS:
            return False
        mean = 0.0
        for k in range(count):
            mean += self._along[self._stretch[k]]
        mean /= count
        variance = 0.0
        third = 0.0
        for k in range(count):
            off = self._along[self._stretch[k]] - mean
            variance += off * off
            third += off * off * off
        variance /= count
        third /= count
        if not variance > 0.0:
            return False
        covariance = 0.0
        square = 0.0
        for k in range(count):
            off = self._along[self._stretch[k]] - mean
            # The square of the place, less what a shift and a turn of the line explain.
            bend = off * off - off * third / variance - variance
            covariance += bend * self._across[self._stretch[k]]
            square += bend * bend
        # The radius is 1 / (2 * covariance / square).
        return 2.0 * fabs(covariance) * _FLAT_RADIUS <= square

    def _mark_candidates(self, count: int, kinds: Indices) -> bool:
        """Mark the members of a stretch of the kind WALL whose neighbour rays are members, too."""
        is_any = False
        for k in range(1, count - 1):
            i = self._stretch[k]
            number = i - self._borrowed
            is_behind = self._own_ray(self._stretch[k - 1] - self._borrowed + 1) == i
            is_before = self._own_ray(number + 1) == self._stretch[k + 1]
            if is_behind and is_before and kinds[i] == WALL:
                self._is_candidate[i] = 1
                is_any = True
        return is_any != 0

    def _deny_returns(self, run: Run, runs: StraightRuns, directions: Doubles) -> None:
        """Deny candidates near a range that is not of the run, measured or filled.

        A filled range on the line of the run is an earlier return of the wall. A return too close
        to measure is anywhere between the lidar and `range_min`, or the outline if it is farther.
        Another body may stand in the shadow of a return, between it and the wall.
        """
        shadow_end = REACH + self._extent
        for i in range(self._rays):
            if self._is_member[i]:
                continue
            if self._state[i] == _TOO_CLOSE:
                ray_x = directions[2 * i]
                ray_y = directions[2 * i + 1]
                outline = self._outline.along_ray(ray_x, ray_y)
                farthest = outline if outline > self._range_min else self._range_min
                self._deny_along(run, runs, ray_x, ray_y, 0.0, farthest)
                continue
            x = self._x[i]
            y = self._y[i]
            is_finite = x - x == 0.0 and y - y == 0.0
            if not is_finite:
                continue
            is_measured = self._state[i] == _RETURN
            is_filled_wall = not is_measured and runs.is_on_line(run, x, y) != 0
            if not is_filled_wall:
                self._deny_beside(run, runs, x, y)
                distance = hypot(x - runs.lidar_x, y - runs.lidar_y)
                self._deny_along(
                    run, runs, directions[2 * i], directions[2 * i + 1], distance, shadow_end
                )

    def _deny_hidden(self, run: Run, runs: StraightRuns, hidden: Table) -> None:
        """Deny candidates near an obstacle hidden in the blind zone.

        The obstacle is between its least distance from the lidar and `range_min`.
        """
        for i in range(len(hidden)):
            least = hidden[i, 2]
            farthest = least if least > self._range_min else self._range_min
            self._deny_along(run, runs, hidden[i, 0], hidden[i, 1], least, farthest)

    def _deny_unmeasured(self, run: Run, runs: StraightRuns, directions: Doubles) -> None:
        """Deny candidates near rays without a measurement along which a part may hide.

        Of a ray towards open space only the place counts at which the ray meets the line of the
        run: else no robot would find a bare wall in the open.
        """
        farthest = REACH + self._extent
        for i in range(self._rays):
            is_measured = self._state[i] == _RETURN or self._state[i] == _TOO_CLOSE
            if is_measured or not self._hides_from[i] < farthest:
                continue
            ray_x = directions[2 * i]
            ray_y = directions[2 * i + 1]
            if not self._is_open[i]:
                self._deny_along(run, runs, ray_x, ray_y, self._hides_from[i], farthest)
                continue
            sine = -self._rise(run, runs, ray_x, ray_y)
            if sine * farthest > self._lidar_height:  # else it meets the line far away, or never
                crossing = self._lidar_height / sine
                place = self._place(run, runs, ray_x, ray_y, crossing)
                self._deny(place - self._extent, place + self._extent)

    def _rise(self, run: Run, runs: StraightRuns, ray_x: float, ray_y: float) -> float:
        """The sine of the angle by which a ray leads away from the line of a run."""
        side = run.ux * (runs.lidar_y - run.y) - run.uy * (runs.lidar_x - run.x)
        rise = run.ux * ray_y - run.uy * ray_x
        return rise if side >= 0.0 else -rise

    def _deny_along(
        self,
        run: Run,
        runs: StraightRuns,
        ray_x: float,
        ray_y: float,
        least: float,
        farthest: float,
    ) -> None:
        """Deny candidates within `_extent` m of the part of a ray between two distances.

        `least`, `farthest`: m from the lidar. Only what lies before the line of the run counts.
        """
        # 1. The part whose height above the line is from 0 to `_extent`.
        extent = self._extent
        rise = self._rise(run, runs, ray_x, ray_y)
        begin = least
        end = farthest
        if fabs(rise) > _PARALLEL_RAY:
            at_line = -self._lidar_height / rise
            at_extent = (extent - self._lidar_height) / rise
            if rise < 0.0:
                begin = at_extent if at_extent > begin else begin
                end = at_line if at_line < end else end
            else:
                end = at_extent if at_extent < end else end
        elif self._lidar_height > extent:
            return
        if not end >= begin:
            return
        # 2. The places along the line that are within `_extent` of this part. Beside an end of the
        # part with the height h these are sqrt(extent^2 - h^2) to both sides. Beside its middle,
        # the line and the ray, which leads along `cosine`, are `_extent` apart.
        first = INFINITY
        last = -INFINITY
        cosine = run.ux * ray_x + run.uy * ray_y
        for k in range(3):
            distance = begin if k == 0 else end
            if k == 2:  # the foot of the perpendicular with the height extent * |cosine|
                if fabs(rise) <= _PARALLEL_RAY:
                    continue
                distance = (extent * fabs(cosine) - self._lidar_height) / rise
                if not begin < distance < end:
                    continue
            height = self._lidar_height + distance * rise
            square = extent * extent - height * height
            half = sqrt(square) if square > 0.0 else 0.0
            place = self._place(run, runs, ray_x, ray_y, distance)
            first = place - half if place - half < first else first
            last = place + half if place + half > last else last
        self._deny(first, last)

    def _place(
        self, run: Run, runs: StraightRuns, ray_x: float, ray_y: float, distance: float
    ) -> float:
        """m along the line of a run, of the place on a ray at a distance from the lidar."""
        x = runs.lidar_x + distance * ray_x - run.x
        y = runs.lidar_y + distance * ray_y - run.y
        return run.ux * x + run.uy * y

    def _deny_beside(self, run: Run, runs: StraightRuns, x: float, y: float) -> None:
        """Deny candidates near the place of a return.

        The lidar sees the near side of a head, and a part may extend `_extent` beyond its far side.
        """
        height = self._height(run, runs, x, y)
        reach = self._extent + _HEAD
        if not fabs(height) <= reach:
            return
        half = sqrt(reach * reach - height * height)
        place = run.ux * (x - run.x) + run.uy * (y - run.y)
        self._deny(place - half, place + half)

    def _deny(self, first: float, last: float) -> None:
        """Deny the candidates between two places along the line of the present run."""
        for i in range(self._rays):
            if self._is_candidate[i] and first <= self._along[i] <= last:
                self._is_candidate[i] = 0


def _between(directions: Doubles, ray: int, other: int) -> float:
    """rad between two rays that are near each other, to 1 % up to 0.5 rad."""
    return hypot(
        directions[2 * ray] - directions[2 * other],
        directions[2 * ray + 1] - directions[2 * other + 1],
    )
