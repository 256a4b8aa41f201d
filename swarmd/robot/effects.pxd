# What C needs of effects.py, which has the meaning of each name.

cimport cython

cdef object _NO_MESSAGES

@cython.final
@cython.auto_pickle(False)
cdef class Effects:
    cdef readonly double now
    cdef public bint is_tick, is_routine, is_latched, is_new_scan, is_new_run
    cdef public object trial, messages
    cdef public tuple replies
    cdef public object host, failed_code, ended, grip, kin_message
    def __init__(self, double now)
