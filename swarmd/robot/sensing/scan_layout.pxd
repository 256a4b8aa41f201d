# What C needs of scan_layout.py, which has the meaning of each name.

cimport cython

cdef int _MAX_LAYOUTS
cdef double _MAX_STEPS

@cython.final
@cython.auto_pickle(False)
cdef class ScanLayout:
    cdef Py_ssize_t n, capacity
    cdef double[::1] given, wrapped
    cdef const double[::1] known
    cdef bint is_ordered
    cdef long long[::1] order
    cdef double[::1] rising, steps
    cdef double spacing, grazing
    cdef double[::1] slopes
    cdef unsigned char[::1] is_apart
    cdef Py_ssize_t count
    cdef long long[::1] sector
    cdef double[::1] lowest
    cdef Py_ssize_t[::1] nearest_ray
    cdef double[:, ::1] point
    cdef double[::1] work
    cdef unsigned char[::1] is_last
    def __init__(self, Py_ssize_t n)

    @cython.locals(n=cython.Py_ssize_t)
    cdef bint is_of(self, const double[::1] bearings)

    @cython.locals(i=cython.Py_ssize_t, n=cython.Py_ssize_t)
    cpdef int set_bearings(self, const double[::1] bearings)

    @cython.boundscheck(False)
    @cython.locals(i=cython.Py_ssize_t)
    cdef set_grazing(self, double grazing)

    @cython.boundscheck(False)
    @cython.locals(count=cython.Py_ssize_t, i=cython.Py_ssize_t)
    cdef set_order(self)

    @cython.locals(i=cython.Py_ssize_t, sector=cython.longlong)
    cdef set_sectors(self, Py_ssize_t count)

@cython.boundscheck(False)
@cython.locals(
    low=cython.Py_ssize_t, high=cython.Py_ssize_t, i=cython.Py_ssize_t, j=cython.Py_ssize_t
)
cdef double _smallest(double[::1] values, Py_ssize_t n, Py_ssize_t k)

cdef layout_of(scan)

@cython.final
@cython.auto_pickle(False)
cdef class ScanLayouts:
    @cython.locals(known=cython.const_double[::1], i=cython.Py_ssize_t, view=cython.const_double[::1])
    cdef of(self, scan)

    cdef ScanLayout _new_layout(self, const double[::1] view)
