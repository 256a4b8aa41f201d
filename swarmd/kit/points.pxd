# What C needs of points.py, which has the meaning of each name.

cimport cython

cdef double _PI, _MIN_LENGTH, _MAX_REVERSE_SHARE, _HEADING_GAIN, _MAX_OCCLUSION_ANGLE, _MERGE_SHARE
cdef double _MAX_LOSS_SHARE, _SAME_PLACE, _MARGIN, _MIN_RANGE
cdef int _BOTH

@cython.locals(
    distance=cython.double, bearing=cython.double, forward=cython.double, left=cython.double
)
def polar_from_base(points, offset)

cdef int _check(double bearing)

@cython.auto_pickle(False)
cdef class NearPoints:
    cdef readonly double nearest

    @cython.locals(distance=cython.double, bearing=cython.double)
    def __init__(self, points)

    @cython.locals(distance=cython.double, toward_x=cython.double, toward_y=cython.double)
    def keep_clear(self, double x, double y, double spacing, double brake)

    @cython.locals(
        distance=cython.double, toward_x=cython.double, length=cython.double,
        speed_share=cython.double
    )
    def steer(
        self, double x, double y, double linear_max, double angular_max, double spacing,
        double brake, bint may_back
    )

@cython.auto_pickle(False)
cdef class RobotsInSight:
    cdef readonly object objects, narrow, polar

    @cython.locals(
        forward=cython.double, left=cython.double, away=cython.double, is_narrow=cython.bint,
        bearing=cython.double, x=cython.double, y=cython.double
    )
    def __init__(self, objects, double width, double reach, offset, named=*)

    @cython.locals(
        distance=cython.double, bearing=cython.double, count=cython.Py_ssize_t, x=cython.double,
        y=cython.double
    )
    def arrangement(self, double near)

    @cython.locals(
        distance=cython.double, bearing=cython.double, x=cython.double, y=cython.double,
        rest=cython.double, weight=cython.double
    )
    def pull(self, double spacing, double brake, double reach)

    @cython.locals(
        distance=cython.double, bearing=cython.double, ahead=cython.double, left=cython.double,
        excess=cython.double
    )
    def keep_in_sight(self, double x, double y, double reach, double brake)

@cython.locals(x=cython.double, y=cython.double)
cdef bint _is_at(one, offset, places)

@cython.locals(
    ray=cython.double[:, ::1], i=cython.Py_ssize_t, count=cython.Py_ssize_t, bearing=cython.double,
    half=cython.double
)
def to_middle(scan, robots)

@cython.locals(
    i=cython.Py_ssize_t, side=cython.int, half=cython.double, away=cython.double,
    bearing=cython.double, usual_half=cython.double
)
def robot_centers(objects, double reach, double width, offset)

@cython.locals(
    i=cython.Py_ssize_t, own_range=cython.double, own_bearing=cython.double, near=cython.double,
    angle=cython.double, side=cython.int
)
cdef int _hidden_side(ranges, bearings, widths, Py_ssize_t index)

cdef double _spread(double distance, double width) noexcept

@cython.locals(edge_angle=cython.double, center_angle=cython.double)
cdef double _angle_to_center(double away, double visible_width, double radius)

@cython.locals(
    i=cython.Py_ssize_t, j=cython.Py_ssize_t, first=cython.Py_ssize_t, second=cython.Py_ssize_t,
    x=cython.double, y=cython.double
)
cdef int _merge(xs, ys, weights, double least)
