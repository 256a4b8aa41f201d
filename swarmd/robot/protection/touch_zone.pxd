# What C needs of touch_zone.py, which has the meaning of each name.

cimport cython

@cython.final
cdef class TouchSector:
    cdef bint is_granted
    cdef double speed, x, y, least_cos
    cdef double[:, ::1] corners
    cdef grant(self, zone, corners)
    cdef inline bint holds(self, double normal_x, double normal_y) noexcept
