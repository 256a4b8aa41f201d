"""How what a peer tells to see fits the place where the own robot sees it. Pure.

A pose of `hypothesis.py` begins by mutual sight, so it takes both lidars for right: a lidar that is
turned by 90 degrees, mirrored or 0.3 m long gives no such pose. Here the path alone tells where the
peer is: the rigid motion that lays its told path upon the path of a track (registration by least
squares: Arun, Huang, Blostein, IEEE PAMI 9(5), 1987). No object that the peer tells counts for it.
Then the peer must tell an object where the own robot is, seen from there:

- A *mark* is a told place of the peer, and the places of all tracks at that time, one each _STEP m.
- A *look* is a comparison after a mark. It has *missed* if no told object is near the expected one;
  else it has the difference of distance and bearing.
- The last _RECENT looks give an *opinion* if most have missed: MISFITS. The mean differences need
  more looks, since the looks of one encounter err alike. Either lidar may be at fault.

Figures of the thresholds: docs/evidence/faults.md. A kernel (see `core/kernels.py`), compiled into
one unit with kin.py. Units: m, s, rad.
"""

from __future__ import annotations

from swarmd.core import cython_shadow as cython
from swarmd.core.angles import PI, wrap
from swarmd.core.buffers import doubles
from swarmd.core.cython_shadow import INFINITY, Doubles, atan2, cos, fabs, sin, sqrt
from swarmd.robot.kin.hypothesis import POINT, length

UNSURE = 0
FITS = 1
MISFITS = 2
"""Opinions of a peer."""
_MARKS = 8
_MARK_TRACKS = 12  # of one mark
_TRACK = 3  # numbers of a track in a mark: its id and place
_HEAD = 4  # numbers before them: time, told place, and the count of tracks
_MARK = _HEAD + _TRACK * _MARK_TRACKS
_STEP = 0.12  # m between two marks
_MARK_GAP = 6.0  # s between two marks
_LEAST_MARKS = 5
_LEAST_EXTENT = 0.13  # m, root mean square of the told places about their middle
_LOOKS = 60
_LEAST_LOOKS = 50  # that have not missed, of mean differences
_RECENT = 8
_LOOK = 3  # numbers of a look: 1 if it has missed, the differences of distance and bearing
_LEAST_MISSED = 6  # recent looks that have missed, of a misfit
_MOST_MISSED = 2  # of a fit
_NEAREST = 0.4  # m to the peer
_FARTHEST = 1.8  # m within which a peer surely tells a robot
# of an object that may be the own robot
_ALIKE_DISTANCE = 0.15  # m
_ALIKE_BEARING = 0.3  # rad
# Mean differences of a misfit. Looks of healthy robots in two runs: 0.02 m and 0 deg, with standard
# deviations of 0.06 m and 4.5 deg; at a lidar that is turned by 10 deg: 8.3 deg.
_MISFIT_DISTANCE = 0.1  # m
_MISFIT_BEARING = 0.096  # rad, 5.5 degrees
# an object nearer by so much, and in this direction, hides the own robot from the peer
_HIDDEN = 0.35  # m, and rad
_FORGOTTEN = 300.0  # s since the last look


@cython.cclass
class SightFit:
    """The marks and looks of one peer. `x`, `y`, `yaw`: its pose, which `fit` has set."""

    x: float
    y: float
    yaw: float
    missed: int  # of the recent looks
    distance: float  # the mean difference of the last looks that have not missed
    bearing: float
    _opinion: int
    _marks: Doubles
    _mark_count: int  # of all since they began
    _looks: Doubles
    _look_count: int
    _looked_at: float

    def __init__(self) -> None:
        self._marks = doubles(_MARKS * _MARK)
        self._looks = doubles(_LOOKS * _LOOK)
        self._looked_at = -INFINITY

    def opinion(self, now: float) -> int:
        """What the last looks say: FITS, MISFITS, or UNSURE."""
        return self._opinion if now - self._looked_at <= _FORGOTTEN else UNSURE

    def text(self) -> str:
        """The figures of the last looks in words."""
        turn = self.bearing / PI * 180.0
        if self.missed > _MOST_MISSED:
            return f"{self.missed} of {_RECENT} looks missed"
        return f"{self.distance:+.2f} m, {turn:+.0f} deg in {_LOOKS} looks"

    def begin_mark(self, time: float, x: float, y: float) -> bool:
        """Begin a mark at this told place; False if the peer has not moved on far enough."""
        marks = self._marks
        if self._mark_count > 0:
            last = _MARK * ((self._mark_count - 1) % _MARKS)
            if length(x - marks[last + 1], y - marks[last + 2]) < _STEP:
                return False
            if not time - marks[last] <= _MARK_GAP:
                self._mark_count = 0
        i = _MARK * (self._mark_count % _MARKS)
        marks[i] = time
        marks[i + 1] = x
        marks[i + 2] = y
        marks[i + 3] = 0.0
        self._mark_count += 1
        return True

    def add(self, id: int, x: float, y: float) -> None:
        """Add the place of a track to the present mark."""
        marks = self._marks
        i = _MARK * ((self._mark_count - 1) % _MARKS)
        count = marks[i + 3]
        if count < _MARK_TRACKS:
            k = i + _HEAD + _TRACK * cython.cast(cython.Py_ssize_t, count)
            marks[k] = id
            marks[k + 1] = x
            marks[k + 2] = y
            marks[i + 3] = count + 1.0

    def fit(self, id: int, told_yaw: float) -> float:
        """Lay the told path upon that of a track; m, the root mean square of what remains.

        inf if the marks do not suffice, or the last one lacks the track. `told_yaw`: of the peer
        at the last mark.
        """
        marks = self._marks
        count = 0
        told_x = 0.0
        told_y = 0.0
        seen_x = 0.0
        seen_y = 0.0
        most = min(self._mark_count, _MARKS)
        for n in range(1, most + 1):
            i = _MARK * ((self._mark_count - n) % _MARKS)
            k = _place_of(marks, i, id)
            if k > 0:
                count += 1
                told_x += marks[i + 1]
                told_y += marks[i + 2]
                seen_x += marks[k]
                seen_y += marks[k + 1]
            elif n == 1:
                return INFINITY
        if count < _LEAST_MARKS:
            return INFINITY
        told_x /= count
        told_y /= count
        seen_x /= count
        seen_y /= count
        along = 0.0
        across = 0.0
        told_extent = 0.0
        seen_extent = 0.0
        for n in range(1, most + 1):
            i = _MARK * ((self._mark_count - n) % _MARKS)
            k = _place_of(marks, i, id)
            if k > 0:
                tx = marks[i + 1] - told_x
                ty = marks[i + 2] - told_y
                sx = marks[k] - seen_x
                sy = marks[k + 1] - seen_y
                along += tx * sx + ty * sy
                across += tx * sy - ty * sx
                told_extent += tx * tx + ty * ty
                seen_extent += sx * sx + sy * sy
        if not told_extent >= count * _LEAST_EXTENT * _LEAST_EXTENT:
            return INFINITY
        turn = atan2(across, along)
        i = _MARK * ((self._mark_count - 1) % _MARKS)
        c = cos(turn)
        s = sin(turn)
        tx = marks[i + 1] - told_x
        ty = marks[i + 2] - told_y
        self.x = seen_x + c * tx - s * ty
        self.y = seen_y + s * tx + c * ty
        self.yaw = told_yaw + turn
        rest = told_extent + seen_extent - 2.0 * length(along, across)
        return sqrt(max(rest, 0.0) / count)

    def look(self, x: float, y: float, objects: Doubles, count: int, time: float) -> None:
        """Compare the told objects with the own place `x`, `y`; after `fit`.

        `objects`: ahead, left and distance from the peer, of which the first `count` are used.
        """
        dx = x - self.x
        dy = y - self.y
        distance = length(dx, dy)
        if not _NEAREST <= distance <= _FARTHEST:
            return
        expected = wrap(atan2(dy, dx) - self.yaw)
        ahead = distance * cos(expected)
        left = distance * sin(expected)
        nearest = INFINITY
        longer = 0.0
        turn = 0.0
        for n in range(count):
            i = POINT * n
            bearing = atan2(objects[i + 1], objects[i])
            aside = wrap(bearing - expected)
            if objects[i + 2] < distance - _HIDDEN and fabs(aside) < _HIDDEN:
                return
            far = length(objects[i] - ahead, objects[i + 1] - left)
            if far < nearest:
                nearest = far
                longer = objects[i + 2] - distance
                turn = aside
        is_missed = not (
            nearest < INFINITY and fabs(longer) <= _ALIKE_DISTANCE and fabs(turn) <= _ALIKE_BEARING
        )
        looks = self._looks
        i = _LOOK * (self._look_count % _LOOKS)
        looks[i] = 1.0 if is_missed else 0.0
        looks[i + 1] = longer
        looks[i + 2] = turn
        self._look_count += 1
        self._looked_at = time
        self._judge()

    def _judge(self) -> None:
        """Make the opinion of the last looks."""
        if self._look_count < _RECENT:
            return
        looks = self._looks
        missed = 0
        hits = 0
        distance = 0.0
        bearing = 0.0
        for n in range(1, min(self._look_count, _LOOKS) + 1):
            i = _LOOK * ((self._look_count - n) % _LOOKS)
            if looks[i] > 0.0:
                missed += n <= _RECENT
            else:
                hits += 1
                distance += looks[i + 1]
                bearing += looks[i + 2]
        self.missed = missed
        self.distance = distance / max(hits, 1)
        self.bearing = bearing / max(hits, 1)
        is_off = fabs(self.distance) > _MISFIT_DISTANCE or fabs(self.bearing) > _MISFIT_BEARING
        if missed >= _LEAST_MISSED or (is_off and hits >= _LEAST_LOOKS):
            self._opinion = MISFITS
        elif missed <= _MOST_MISSED:
            self._opinion = UNSURE if is_off else FITS
        elif self._opinion == FITS:  # a misfit stays until the looks fit
            self._opinion = UNSURE


def _place_of(marks: Doubles, mark: int, id: int) -> int:
    """Where in `marks` the place of a track in a mark begins; 0 without one."""
    k = mark + _HEAD
    for _ in range(cython.cast(cython.Py_ssize_t, marks[mark + 3])):
        if marks[k] == id:
            return k + 1
        k += _TRACK
    return 0
