# What C needs of feasible_set.py, which has the meaning of each name.

cimport cython

cdef Py_ssize_t _NO_ODOMETRY

@cython.final
cdef class Situation:
    cdef bint is_known
    cdef double now, scan_age, odometry_age
    cdef Py_ssize_t version
    cdef double along_x, along_y

    cdef int keep(
        self, double now, double scan_age, double odometry_age, Py_ssize_t version, double along_x,
        double along_y
    ) except? -1

@cython.final
cdef class FeasibleSet:
    cdef int is_unbounded(self) except? -1
    cdef int take_context(self, context, command, touch) except? -1
    cdef int has_scan_pose(self) except? -1

    @cython.locals(is_known=cython.bint)
    cdef int enter(self, context, command, double along_x, double along_y, double limit) except? -1

    @cython.locals(has_odometry=cython.bint)
    cdef int _build(self, double linear, double angular, double lateral) except? -1

    @cython.locals(k=cython.Py_ssize_t)
    cdef int _place_told(self, double odometry_age, double not_extrapolated) except? -1

    @cython.locals(k=cython.Py_ssize_t, first_disc=cython.Py_ssize_t, disc=cython.Py_ssize_t)
    cdef int _add_discs(self, double odometry_age, double not_extrapolated) except? -1

    @cython.locals(i=cython.Py_ssize_t, is_contact_forbidden=cython.bint)
    cdef int _is_touching(self) except? -1
