# What C needs of state_machine.py, which has the meaning of each name.

cimport cython

@cython.final
cdef class StateMachine:
    cdef readonly object state, reason, detail
    cdef readonly double since
    def __init__(self, double now)
    def apply(self, trigger, reason, detail, double now)
