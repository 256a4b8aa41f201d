# What C needs of barrier_assumptions.py, which has the meaning of each name.

cimport cython

cdef double REACTION
cdef long long OTHER, WALL, BARE_WALL

@cython.final
cdef class Assumptions:
    cdef double others_speed, standing_speed, unseen_extent, foot, margin, braking_linear
    cdef double braking_angular, linear_limit, angular_limit, surface_speed, top_surface_speed
    cdef bint has_kinds
    cdef double side_reserve, keep_out, blind_radius, fresh_binding_range, envelope_range
    cdef double longest_scan_age
    cdef bint may_creep
    cdef inline double speed_of(self, long long kind) noexcept
    cdef inline double extent_of(self, long long kind) noexcept
    cdef inline bint has_keep_out(self) noexcept
    cdef inline double binding_range(self, double age) noexcept
