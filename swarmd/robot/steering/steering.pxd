# What C needs of steering.py, which has the meaning of each name.

cimport cython

cdef object _partial

cdef class Steering:
    cdef bint _is_recovering, _may_recover
    cdef public object _tracker
    cdef public bint must_track
    cdef bint _avoids, _is_avoiding, _has_avoided
    cdef bint _is_tracking(self)

    @cython.locals(may_move=cython.bint)
    def steer(self, requested, context, bint is_running, hold, permit=*)

    @cython.locals(is_avoiding=cython.bint)
    cdef _switch_avoidance(self, bint is_running, permit)
    cdef _end_recovery(self, Recovery recovery)
    cdef _candidate(self, Recovery recovery, clipped, context, touch)
    cdef _pass_others(self, Recovery recovery, requested, context, allows, Points points)
