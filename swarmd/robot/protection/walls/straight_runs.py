"""The straight runs of a scan: what standing_walls.py compares with the walls of the scan before.

1. Returns of this revolution of the lidar within REACH m form chains. A chain ends where
   neighbouring returns lie farther apart than SPACING, or where a ray passes through.
2. Chains are split where they are not straight (Douglas and Peucker, 1973), and each part gets a
   line by total least squares. Parts on one line are joined again over returns that are off the
   line, unless a ray passes through between the parts. The result is a run.
3. A run is long if its ends are `length` m apart and its returns do not bend. Parts of a round
   surface are runs, too, but bend: a parabola is fitted to the returns of each run.

Part of the unit of barrier.py. Units: m, s, in the base frame at the time of the newest ray.
"""

from __future__ import annotations

from swarmd.core import cython_shadow as cython
from swarmd.core.buffers import doubles, indices
from swarmd.core.cython_shadow import INFINITY, NAN, Doubles, Indices, fabs, hypot, sqrt
from swarmd.core.values import Platform
from swarmd.robot.protection.obstacles import REACH

# m between neighbouring returns of a surface: less than a Burger's 0.14 m, and more than the 0.07 m
# of an e-puck2 and the 0.11 m of a Thymio.
SPACING = 0.12
# m between the end of a wall and the face that begins there: less than robots leave free.
_CORNER = 0.04
_STRAIGHT = 0.05  # m by which a return may be off its chord
_ROUGH = 0.025  # m, root mean square of the residuals of a run
_ON_LINE = 0.035  # m by which a return that stands may be off
_THROUGH = 0.05  # m behind the line: the ray passed through it
# m: a long run bends with a larger radius. Noise of 1 cm in 40 returns over 0.5 m changes
# 1 / radius by 0.17 / m (one standard deviation): such a wall is refused in 1 scan of 10,000, a
# tank of 1 m radius in 97 of 100.
_LEAST_RADIUS = 1.5
_FEWEST = 5  # returns of a run
# What `_bridge` permits: m between two returns, and single rays without a return in a scan. Of 150
# rays beside a wall of which 1 % are lost, 99.6 of 100 scans have no more.
_BRIDGED = 0.05
_LOST_ALONE = 5
# Periods: an older ray is of an earlier revolution. If the robot turns against the lidar, the
# newest ray of some directions is older than a period.
_LATE_RAY = 1.5
_RUNS = 64  # the most runs of a scan
_STACK = 128  # two numbers for each part that is to be split

# The sums over returns.
_SUM_COUNT = 0
_SUM_X = 1
_SUM_Y = 2
_SUM_XX = 3
_SUM_XY = 4
_SUM_YY = 5
_SUMS = 6


@cython.cclass
class Run:
    """A straight run of returns that follow each other, and its line."""

    first: int  # the index of its first return
    length: int  # the returns that follow
    sums: Doubles  # the _SUMS sums over its returns
    x: float  # m, a point of its line
    y: float
    ux: float  # the unit vector along its line
    uy: float
    begin: float  # m along its line from this point to its begin
    end: float  # m along its line from this point to its end
    owner: int  # the index of the wall that it continues; -1: none
    is_long: bool  # long and straight

    def __init__(self) -> None:
        self.sums = doubles(_SUMS)


@cython.cclass
class StraightRuns:
    """The returns of a scan near the lidar, and the straight runs of them."""

    runs: list[Run]  # _RUNS, of which the first `count` are those of the scan
    count: int
    x: Doubles  # of each return
    y: Doubles
    ray: Indices  # of each return
    lidar_x: float
    lidar_y: float
    _length: float  # m of a long run
    oldest: float  # s, the greatest age of a ray of this revolution
    _returns: int
    _bridges: bool  # single rays without a return between near returns do not end a chain
    _is_single: Indices  # of each return: 1 if it is cut by a single ray
    _is_cut: Indices  # of each return: 1 if a ray before passes through
    _sums: Doubles  # _SUMS for each return: the sums over all returns before it
    _places: Doubles  # of the returns on the line of a run: m along and across the line
    _stack: Indices

    def __init__(self, platform: Platform, length: float, *, bridges: bool = False) -> None:
        """`bridges`: a ray that was lost alone does not end a chain, see `_bridge`."""
        self._length = length
        self.oldest = _LATE_RAY * (1.0 / platform.scan.rate)
        self._bridges = bridges
        self.lidar_x, self.lidar_y = platform.scan.offset
        self.runs = [Run() for _ in range(_RUNS)]
        self._stack = indices(_STACK)
        self._allocate(len(platform.scan.bearings))

    def _allocate(self, rays: int) -> None:
        """Make the arrays of a scan anew, for so many rays."""
        self.ray = indices(rays)
        self._is_cut = indices(rays)
        self._is_single = indices(rays)
        self.x = doubles(rays)
        self.y = doubles(rays)
        self._sums = doubles(_SUMS * (rays + 1))
        self._places = doubles(2 * rays)

    def find(self, ranges: Doubles, directions: Doubles, ages: Doubles) -> None:
        """Find the runs of a scan, as StandingWalls.observe gives it."""
        if len(self.ray) < len(ranges):
            self._allocate(len(ranges))
        self._place(ranges, directions, ages)
        if self._bridges:
            self._bridge()
        self._find_runs()
        self._join_runs()
        for j in range(self.count):
            run: Run = self.runs[j]
            run.owner = -1
            is_long = run.end - run.begin >= self._length
            run.is_long = is_long and self._is_straight(run) != 0

    def _is_straight(self, run: Run) -> bool:
        """True if the returns of a run bend with a radius of at least _LEAST_RADIUS m.

        0 also if fewer than _FEWEST returns are on the line of the run. A parabola is fitted to the
        returns on the line: their distance across the line as a function of their place along the
        line. The radius is that of the parabola.
        """
        on_line = 0
        places = self._places
        # 1. The returns on the line, and the sums of the powers of their places along the line.
        first = 0.0
        second = 0.0
        third = 0.0
        for k in range(run.length + 1):
            place = self.along(run, k)
            is_on_line = place == place  # NaN for a return off the line
            if is_on_line:
                places[2 * on_line] = place
                places[2 * on_line + 1] = self._before(run, self.return_of(run, k))
                first += place
                second += place * place
                third += place * place * place
                on_line += 1
        if on_line < _FEWEST:
            return False
        mean = first / on_line
        variance = second / on_line - mean * mean
        third_moment = third / on_line - mean * (3.0 * variance + mean * mean)
        if not variance > 0.0:
            return False
        # 2. The coefficient of the square, by least squares: covariance / square. `bend` is the
        # square of the place, less what a shift and a turn of the line explain.
        covariance = 0.0
        square = 0.0
        for k in range(on_line):
            off_mean = places[2 * k] - mean
            across = places[2 * k + 1]
            bend = off_mean * off_mean - off_mean * third_moment / variance - variance
            covariance += bend * across
            square += bend * bend
        # 3. The radius is 1 / (2 * coefficient). The comparison has no division by 0.
        return 2.0 * fabs(covariance) * _LEAST_RADIUS <= square

    def _place(self, ranges: Doubles, directions: Doubles, ages: Doubles) -> None:
        """Place the returns of this revolution within REACH m, and add them to the running sums.

        A ray passes through before a return if the ray has no return within REACH m. A return too
        close to measure is left out, but no ray passes through there. The arguments are those of
        `find`.
        """
        k = 0
        has_ages = len(ages) > 0
        is_cut = False
        passing = 0  # rays that pass through since the return before
        for i in range(_SUMS):
            self._sums[i] = 0.0
        for i in range(len(ranges)):
            is_of_revolution = not has_ages or ages[i] <= self.oldest
            if not is_of_revolution:
                continue
            distance = ranges[i]
            if not distance <= REACH:  # the ray passes through
                is_cut = True
                passing += 1
                continue
            if not distance > 0.0:  # -inf: too close to measure
                continue
            x = self.lidar_x + distance * directions[2 * i]
            y = self.lidar_y + distance * directions[2 * i + 1]
            self.x[k] = x
            self.y[k] = y
            self.ray[k] = i
            self._is_cut[k] = is_cut
            self._is_single[k] = passing == 1 and i > 0 and ranges[i - 1] == INFINITY
            self._add_to_sums(k, x, y)
            is_cut = False
            passing = 0
            k += 1
        self._returns = k
        # The first return follows the last return, so a ray behind the last return counts, too.
        if k and is_cut:
            self._is_cut[0] = True

    def _bridge(self) -> None:
        """Let single rays without a return not end a chain.

        A sensor may lose a ray here and there, and reports it as a ray without a return. The
        returns on both sides must be less than _BRIDGED m apart. A scan with more than _LOST_ALONE
        of these rays keeps all cuts: a row of bodies has more such gaps.
        """
        bridged = 0
        for k in range(1, self._returns):
            if self._is_single[k] and self._are_within(_BRIDGED, k - 1, k):
                bridged += 1
        if bridged > _LOST_ALONE:
            return
        for k in range(1, self._returns):
            if self._is_single[k] and self._are_within(_BRIDGED, k - 1, k):
                self._is_cut[k] = 0

    def _add_to_sums(self, k: int, x: float, y: float) -> None:
        """Set the sums over the returns up to return `k`, whose place is (x, y) in m."""
        sums = self._sums
        before = _SUMS * k
        to = before + _SUMS
        sums[to + _SUM_COUNT] = sums[before + _SUM_COUNT] + 1.0
        sums[to + _SUM_X] = sums[before + _SUM_X] + x
        sums[to + _SUM_Y] = sums[before + _SUM_Y] + y
        sums[to + _SUM_XX] = sums[before + _SUM_XX] + x * x
        sums[to + _SUM_XY] = sums[before + _SUM_XY] + x * y
        sums[to + _SUM_YY] = sums[before + _SUM_YY] + y * y

    def _find_runs(self) -> None:
        """Split the returns into chains, and these into straight runs."""
        begin = 0
        count = self._returns
        self.count = 0
        for k in range(1, count + 1):
            if k < count and not self._is_cut[k] and self._are_within(SPACING, k - 1, k):
                continue
            if k - begin >= _FEWEST:
                self._split(begin, k - 1)
            begin = k

    def _are_within(self, distance: float, a: int, b: int) -> bool:
        """True if two returns are at most `distance` m apart."""
        dx = self.x[b] - self.x[a]
        dy = self.y[b] - self.y[a]
        return dx * dx + dy * dy <= distance * distance

    def _split(self, begin: int, end: int) -> None:
        """Add the straight runs of the chain from return `begin` to return `end`, in their order.

        A part whose farthest return from the chord is more than _STRAIGHT m off is split there.
        """
        stack = self._stack
        top = 2
        stack[0] = begin
        stack[1] = end
        while top > 0:
            top -= 2
            first = stack[top]
            last = stack[top + 1]
            if last - first + 1 < _FEWEST:
                continue
            # 1. The return that is farthest from the chord.
            x = self.x[first]
            y = self.y[first]
            dx = self.x[last] - x
            dy = self.y[last] - y
            length = hypot(dx, dy)
            farthest = first
            most = 0.0
            for k in range(first + 1, last):
                off = fabs(dx * (self.y[k] - y) - dy * (self.x[k] - x))
                if off > most:
                    most = off
                    farthest = k
            # 2. Splits there, the later part first on the stack; or adds a run.
            if most > _STRAIGHT * length and farthest > first:
                if top + 4 > _STACK:
                    return  # a chain of noise: the rest of it has no runs
                stack[top] = farthest
                stack[top + 1] = last
                stack[top + 2] = first
                stack[top + 3] = farthest
                top += 4
            elif self.count < _RUNS:
                self._add_run(first, last)

    def _add_run(self, first: int, last: int) -> None:
        """Add the run from return `first` to return `last`, if it is smooth."""
        run: Run = self.runs[self.count]
        run.first = first
        run.length = last - first
        for j in range(_SUMS):
            run.sums[j] = self._sums[_SUMS * (last + 1) + j] - self._sums[_SUMS * first + j]
        if self._fit(run):
            self.count += 1

    def _fit(self, run: Run) -> bool:
        """Set the line of a run by its sums; False for a rough run.

        The line is fitted by total least squares, and leads from the first return to the last. A
        run is rough if its returns are too far off this line.
        """
        # 1. The covariance of the returns.
        n = run.sums[_SUM_COUNT]
        x = run.sums[_SUM_X] / n
        y = run.sums[_SUM_Y] / n
        xx = run.sums[_SUM_XX] / n - x * x
        xy = run.sums[_SUM_XY] / n - x * y
        yy = run.sums[_SUM_YY] / n - y * y
        # 2. The lesser eigenvalue of the covariance: the mean square of the distances to the line.
        half = 0.5 * (xx - yy)
        root = sqrt(half * half + xy * xy)
        lesser = 0.5 * (xx + yy) - root
        if not lesser <= _ROUGH * _ROUGH:
            return False
        # 3. The direction of the line: the eigenvector of the greater eigenvalue. There are two
        # formulas for this vector. Each is exact where both numbers that it adds have one sign.
        ux = half + root if half >= 0.0 else xy
        uy = xy if half >= 0.0 else root - half
        length = hypot(ux, uy)
        if not length > 0.0:
            return False
        # 4. The unit vector of this direction, towards the last return.
        first = run.first
        last = self.return_of(run, run.length)
        along = ux * (self.x[last] - self.x[first])
        along += uy * (self.y[last] - self.y[first])
        length = -length if along < 0.0 else length  # a negative length reverses the vector
        ux = ux / length
        uy = uy / length
        run.x = x
        run.y = y
        run.ux = ux
        run.uy = uy
        run.begin = ux * (self.x[first] - x) + uy * (self.y[first] - y)
        run.end = ux * (self.x[last] - x) + uy * (self.y[last] - y)
        return True

    def return_of(self, run: Run, number: int) -> int:
        """The index of a return of a run: `number` returns behind its first one."""
        place = run.first + number
        return place - self._returns if place >= self._returns else place

    def _join_runs(self) -> None:
        """Join runs that follow each other on one line; the first run follows the last one."""
        kept = 0
        for i in range(self.count):
            run: Run = self.runs[i]
            if kept and self._join(self.runs[kept - 1], run):
                continue
            self.runs[i] = self.runs[kept]
            self.runs[kept] = run
            kept += 1
        if kept > 1 and self._join(self.runs[kept - 1], self.runs[0]):
            kept -= 1
            run = self.runs[kept]
            self.runs[kept] = self.runs[0]
            self.runs[0] = run
        self.count = kept

    def _join(self, run: Run, after: Run) -> bool:
        """Join the run `after` to a run; False if they are not of one line."""
        last = self.return_of(run, run.length)
        first = after.first
        # 1. The distance from the last return of `run` to the first return of `after`: at most
        # SPACING m along the line. The distance is negative if the runs overlap: if the robot turns
        # with the lidar, the last run of the scan overlaps the first run.
        dx = self.x[first] - self.x[last]
        dy = self.y[first] - self.y[last]
        along = run.ux * dx + run.uy * dy
        across = run.ux * dy - run.uy * dx
        most_overlap = run.begin - run.end
        if not (most_overlap <= along <= SPACING and fabs(across) <= 2.0 * _STRAIGHT):
            return False
        # 2. No ray between the two runs may pass through the line. The first return follows the
        # last return.
        steps = first - last  # from the last return of `run` to `first`
        if steps <= 0:
            steps += self._returns
        if self._passes_through(run, last, steps):
            return False
        # 3. Fits a line to the returns of both runs. If the joined run is rough, or contains all
        # returns of the scan, `run` becomes what it was.
        kept = run.length
        for j in range(_SUMS):
            run.sums[j] += after.sums[j]
        run.length = kept + steps + after.length
        if run.length < self._returns and self._fit(run):
            return True
        for j in range(_SUMS):
            run.sums[j] -= after.sums[j]
        run.length = kept
        return False

    def _passes_through(self, run: Run, last: int, steps: int) -> bool:
        """True if a ray at the `steps` returns behind return `last` passes the line of a run.

        A ray without a return passes through, and so does a ray whose return is behind the line.
        """
        for k in range(1, steps + 1):
            place = last + k
            place = place - self._returns if place >= self._returns else place
            if self._is_cut[place] or self._before(run, place) < -_THROUGH:
                return True
        return False

    def corner_of(self, number: int) -> int:
        """The return of a long run that meets run `number` at a corner; -1 without such a return.

        Run `number` must lead away behind the line of the long run, as the post of a door does. A
        run that stands out before the line may be a body that stands at a wall.
        """
        run: Run = self.runs[number]
        for k in range(2):
            beside = number - 1 if k == 0 else number + 1
            beside = beside + self.count if beside < 0 else beside
            beside = beside - self.count if beside >= self.count else beside
            other: Run = self.runs[beside]
            if not other.is_long:
                continue
            near = self.return_of(other, 0 if k else other.length)
            own = self.return_of(run, run.length if k else 0)
            far = self.return_of(run, 0 if k else run.length)
            if self._are_within(_CORNER, near, own) and self._before(other, far) <= _ON_LINE:
                return near
        return -1

    def _before(self, run: Run, place: int) -> float:
        """m by which a return lies before the line of a run, seen from the lidar; < 0: behind."""
        nx = -run.uy
        ny = run.ux
        x = run.x
        y = run.y
        off = nx * (self.x[place] - x) + ny * (self.y[place] - y)
        return off if nx * (self.lidar_x - x) + ny * (self.lidar_y - y) >= 0.0 else -off

    def along(self, run: Run, number: int) -> float:
        """m along a run of its return `number`; NaN for a return that is not on the line."""
        place = self.return_of(run, number)
        if not self.is_on_line(run, self.x[place], self.y[place]):
            return NAN
        return run.ux * (self.x[place] - run.x) + run.uy * (self.y[place] - run.y)

    def is_on_line(self, run: Run, x: float, y: float) -> bool:
        """True if a place is so near the line of a run that a return there stands with the run."""
        across = run.ux * (y - run.y) - run.uy * (x - run.x)
        return fabs(across) <= _ON_LINE
