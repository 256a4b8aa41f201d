# What C needs of ray_motion.py, which has the meaning of each name.

cimport cython

cdef double _SMALL_TANGENT, _LEAST_SHARE, _ROUNDING

cdef inline double _moved_range(double along, double across, double least, double most) noexcept
cdef inline double _moved_bearing(double bearing, double turn, double along, double across) noexcept

@cython.locals(
    count=cython.Py_ssize_t, last_row=cython.Py_ssize_t, row=cython.Py_ssize_t,
    i=cython.Py_ssize_t
)
cpdef int move_rays(
    const double[::1] ranges, const double[::1] bearings, const double[::1] cosines,
    const double[::1] sines, const double[::1] ages, double[:, ::1] path, Py_ssize_t row_count,
    double[::1] limits, double[::1] distances, double[::1] angles
)

@cython.locals(n=cython.Py_ssize_t, count=cython.Py_ssize_t, i=cython.Py_ssize_t)
cpdef Py_ssize_t rays_in_sector(
    const double[::1] ranges, const double[::1] bearings, const double[::1] ages, Py_ssize_t first,
    double[::1] motion, double[::1] sector, double[::1] limits, double[::1] distances,
    double[::1] angles, double[::1] kept_ages
)
