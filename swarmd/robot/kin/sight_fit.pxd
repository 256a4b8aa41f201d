# What C needs of sight_fit.py, which has the meaning of each name.

cimport cython

cdef Py_ssize_t UNSURE, FITS, MISFITS
cdef Py_ssize_t _MARKS, _MARK_TRACKS, _TRACK, _HEAD, _MARK
cdef double _STEP, _MARK_GAP
cdef Py_ssize_t _LEAST_MARKS
cdef double _LEAST_EXTENT
cdef Py_ssize_t _LOOKS, _LEAST_LOOKS, _RECENT, _LOOK, _LEAST_MISSED, _MOST_MISSED
cdef double _NEAREST, _FARTHEST, _ALIKE_DISTANCE, _ALIKE_BEARING, _MISFIT_DISTANCE, _MISFIT_BEARING
cdef double _HIDDEN, _FORGOTTEN

@cython.final
cdef class SightFit:
    cdef double x, y, yaw, distance, bearing
    cdef Py_ssize_t missed, _opinion
    cdef double[::1] _marks, _looks
    cdef Py_ssize_t _mark_count, _look_count
    cdef double _looked_at
    cdef Py_ssize_t opinion(self, double now)

    @cython.locals(turn=cython.double)
    cdef text(self)

    @cython.locals(marks=cython.double[::1], last=cython.Py_ssize_t, i=cython.Py_ssize_t)
    cdef bint begin_mark(self, double time, double x, double y)

    @cython.locals(
        marks=cython.double[::1], i=cython.Py_ssize_t, k=cython.Py_ssize_t, count=cython.double
    )
    cdef int add(self, long long id, double x, double y)

    @cython.locals(
        marks=cython.double[::1], count=cython.Py_ssize_t, told_x=cython.double,
        told_y=cython.double, seen_x=cython.double, seen_y=cython.double, most=cython.Py_ssize_t,
        n=cython.Py_ssize_t, i=cython.Py_ssize_t, k=cython.Py_ssize_t, along=cython.double,
        across=cython.double, told_extent=cython.double, seen_extent=cython.double,
        tx=cython.double, ty=cython.double, sx=cython.double, sy=cython.double,
        turn=cython.double, c=cython.double, s=cython.double, rest=cython.double
    )
    cdef double fit(self, long long id, double told_yaw)

    @cython.locals(
        dx=cython.double, dy=cython.double, distance=cython.double, expected=cython.double,
        ahead=cython.double, left=cython.double, nearest=cython.double, longer=cython.double,
        turn=cython.double, n=cython.Py_ssize_t, i=cython.Py_ssize_t, bearing=cython.double,
        aside=cython.double, far=cython.double, is_missed=cython.bint, looks=cython.double[::1]
    )
    cdef int look(self, double x, double y, double[::1] objects, Py_ssize_t count, double time)

    @cython.locals(
        looks=cython.double[::1], missed=cython.Py_ssize_t, hits=cython.Py_ssize_t, distance=cython.double,
        bearing=cython.double, n=cython.Py_ssize_t, i=cython.Py_ssize_t, is_off=cython.bint
    )
    cdef int _judge(self)

@cython.locals(k=cython.Py_ssize_t, _=cython.Py_ssize_t)
cdef inline Py_ssize_t _place_of(double[::1] marks, Py_ssize_t mark, long long id) noexcept
