# What C needs of limiting_obstacles.py, which has the meaning of each name.

cimport cython

cdef double BINDING_TOLERANCE
cdef Py_ssize_t MAX_REPORTED
cdef double _AT_AXLE

@cython.final
cdef class LimitingRows:
    cdef Py_ssize_t count

    @cython.locals(
        i=cython.Py_ssize_t, tight_count=cython.Py_ssize_t, points=cython.Py_ssize_t,
        nearest_row=cython.Py_ssize_t
    )
    cdef report(self, double x, double y)

    @cython.locals(point=cython.Py_ssize_t)
    cdef _obstacle(self, ConstraintRows rows, PlacedPoints placed, Py_ssize_t row)

    @cython.locals(point=cython.Py_ssize_t)
    cdef double _age_cost(
        self, ConstraintRows rows, PlacedPoints placed, Py_ssize_t row
    ) except? -1.0

    @cython.locals(point=cython.Py_ssize_t)
    cdef double _closing_cap(
        self, ConstraintRows rows, PlacedPoints placed, Py_ssize_t row, double unseen
    ) except? -1.0

    @cython.locals(rank=cython.Py_ssize_t, place=cython.Py_ssize_t, before=cython.Py_ssize_t)
    cdef int _rank(self, ConstraintRows rows, Py_ssize_t row) except? -1
