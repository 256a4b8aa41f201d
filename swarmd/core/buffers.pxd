# What C needs of buffers.py, which has the meaning of each name.

cdef view(values)
cdef view_of(values)
cdef double[::1] doubles(Py_ssize_t count)
cdef double[::1] scratch(Py_ssize_t count)
cdef long long[::1] indices(Py_ssize_t count)
cdef unsigned char[::1] flags(Py_ssize_t count)
cdef inline double* checked(double[::1] values, Py_ssize_t count)
cdef inline long long* checked_indices(long long[::1] values, Py_ssize_t count)
cdef inline Py_ssize_t wrapped_index(Py_ssize_t i, Py_ssize_t n) noexcept
