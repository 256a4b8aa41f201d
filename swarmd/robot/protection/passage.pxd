# What C needs of passage.py, which has the meaning of each name.

cimport cython

@cython.final
cdef class Room:
    @cython.locals(i=cython.Py_ssize_t, age=cython.double, ahead=cython.double)
    def clearance(self, speed)
    cdef double _fastest_at(self, double distance, double front, double age) except? -1.0
