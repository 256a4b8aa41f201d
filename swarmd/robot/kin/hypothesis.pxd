# What C needs of hypothesis.py, which has the meaning of each name.

cimport cython

cdef Py_ssize_t POINT
cdef double MOST_SCORE, _NEWS, _SIGHT_NOISE, _RANGE_NOISE, _GATE, _MOST_GATE, _DENSITY, _TRUST
cdef double _MOST_GAIN, _PLACE_DRIFT, _TURN_DRIFT, _YAW_DRIFT, _LEAST

@cython.final
cdef class Evidence:
    cdef Py_ssize_t count
    cdef double extent, _first_x, _first_y, _last_x, _last_y
    cdef int begin(self, double x, double y)
    cdef bint is_news(self, double x, double y)
    cdef int add(self, double x, double y)

@cython.final
cdef class Hypothesis:
    cdef double x, y, yaw, xx, xy, xt, yy, yt, tt, score, seen_at
    cdef int prove(self, double peer_x, double peer_y, double own_x, double own_y)
    cdef double sd(self)

    @cython.locals(c=cython.double, s=cython.double, dx=cython.double, dy=cython.double)
    cdef int move(self, double ahead, double left, double turn)

    @cython.locals(yaw=cython.double, place=cython.double)
    cdef int drift(self, double way, double turn, double lever)
    cdef bint see(self, double[::1] places, Py_ssize_t count, double distance, bint is_news)

    @cython.locals(c=cython.double, s=cython.double, ahead=cython.double, left=cython.double)
    cdef bint be_seen(self, double[::1] objects, Py_ssize_t count, double x, double y, bint is_news)

    @cython.locals(sd=cython.double)
    cdef double fits(self, double dx, double dy)
    cdef bint is_like(self, double x, double y, double yaw, double share)

    @cython.locals(
        ax=cython.double, ay=cython.double, at=cython.double, bx=cython.double, by=cython.double,
        bt=cython.double, noise=cython.double, s11=cython.double, s12=cython.double,
        s22=cython.double, nearest=cython.double, dx=cython.double, dy=cython.double,
        i=cython.Py_ssize_t, k=cython.Py_ssize_t, det=cython.double, i11=cython.double,
        i12=cython.double, i22=cython.double, u=cython.double, v=cython.double, far=cython.double,
        area=cython.double, ratio=cython.double, gain=cython.double
    )
    cdef bint _take(
        self, double[::1] points, Py_ssize_t count, double x, double y, double ux, double uy,
        double ut, double vx, double vy, double vt, double distance, bint is_news
    )

@cython.locals(det=cython.double, far=cython.double)
cdef inline double _deviation(double dx, double dy, double xx, double xy, double yy) noexcept

cdef Hypothesis begun(double x, double y, double yaw, double sd, double yaw_sd)
cdef inline double length(double x, double y) noexcept
