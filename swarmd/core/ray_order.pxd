# What C needs of ray_order.py, which has the meaning of each name.

cimport cython

cdef Py_ssize_t _MOVES_A_RAY

@cython.locals(
    i=cython.Py_ssize_t, k=cython.Py_ssize_t, ray=cython.Py_ssize_t, index_step=cython.Py_ssize_t,
    moves_left=cython.Py_ssize_t, found=cython.longlong[::1]
)
cdef sort_rays(double[::1] angles, Py_ssize_t count, double[::1] rising, long long[::1] order)
