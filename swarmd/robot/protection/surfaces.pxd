# What C needs of surfaces.py, which has the meaning of each name.

cimport cython

cdef double SURFACE_SPACING, WIDE_SURFACE, PEER_RESERVE, BOX_FACTOR
cdef Py_ssize_t MEAN_RAYS, EDGE_RAYS
cdef double MEAN_BELOW, _SURELY_NEAR

@cython.locals(
    i=cython.Py_ssize_t, begin=cython.Py_ssize_t, start=cython.Py_ssize_t, at=cython.Py_ssize_t,
    end=cython.Py_ssize_t, is_wide=cython.bint, width=cython.double, reserve=cython.double, widest_peer=cython.double,
    neighbours=cython.Py_ssize_t, near_ends=cython.Py_ssize_t
)
cdef int find_surface_gaps(
    double[::1] x, double[::1] y, double[::1] gap, Py_ssize_t count, Outline outline,
    double longest_peer, double[::1] surface_gap
) except? -1

@cython.locals(across=cython.double, along=cython.double)
cdef int _is_step(double[::1] x, double[::1] y, Py_ssize_t i, Py_ssize_t j) except -1

@cython.locals(
    i=cython.Py_ssize_t, reach=cython.Py_ssize_t, total=cython.Py_ssize_t, first=cython.Py_ssize_t
)
cdef double _gap_of_mean(
    double[::1] x, double[::1] y, Py_ssize_t at, Py_ssize_t most, Py_ssize_t count,
    Outline outline
) except? -1.0
