# What C needs of barrier.py, which has the meaning of each name.

cimport cython

cdef double SLOW_REQUEST, CREEP_GAIN
cdef object _make_decision

@cython.final
cdef class Barrier:
    cdef bint _is_decided, _is_limited

    @cython.locals(age=cython.double, odometry_age=cython.double)
    def observe(self, scan, geometry, context)

    @cython.locals(
        speed=cython.double, angular=cython.double, lateral=cython.double, is_zero=cython.bint,
        along_x=cython.double, along_y=cython.double, limit=cython.double,
        is_same_situation=cython.bint, is_same_request=cython.bint, linear=cython.double
    )
    def decide(self, requested, context, command, touch)

    @cython.locals(
        wanted_x=cython.double, wanted_y=cython.double, is_reduced=cython.bint,
        slow_cap=cython.double
    )
    cdef int _judge(self, double speed, double angular) except? -1
    cdef int _is_locked(self) except? -1
    cdef int _creep(self, double wanted_x, double wanted_y) except? -1
    cdef int _creep_out(self, double wanted_x, double wanted_y, double least) except? -1
