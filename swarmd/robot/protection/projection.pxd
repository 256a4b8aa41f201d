# What C needs of projection.py, which has the meaning of each name.

cimport cython

cdef double TOLERANCE
cdef Py_ssize_t _FEW_ROWS

@cython.final
cdef class Projection:
    cdef double x, y
    cdef Py_ssize_t _sides
    cdef double[::1] _corner_x, _corner_y, _clipped_x, _clipped_y

    @cython.locals(worst_row=cython.Py_ssize_t)
    cdef int project(self, ConstraintRows rows, double x, double y) except? -1

    @cython.locals(
        i=cython.Py_ssize_t, first=cython.Py_ssize_t, last=cython.Py_ssize_t,
        row_count=cython.Py_ssize_t, worse=cython.Py_ssize_t, worst_row=cython.Py_ssize_t,
        excess=cython.double
    )
    cdef Py_ssize_t _most_violated(self, ConstraintRows rows) except? -2
    cdef int _begin_with_box(self) except? -1

    @cython.locals(i=cython.Py_ssize_t, count=cython.Py_ssize_t)
    cdef int _clip(self, double a, double b, double cap) except? -1

    @cython.locals(i=cython.Py_ssize_t)
    cdef int _find_nearest(self, double x, double y) except? -1

@cython.locals(i=cython.Py_ssize_t)
cdef int is_feasible(ConstraintRows rows, double x, double y) except? -1
