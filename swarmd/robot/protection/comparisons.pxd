# What C needs of comparisons.py, which has the meaning of each name.

cdef inline double maximum(double a, double b) noexcept
cdef inline double at_least(double value, double least) noexcept
cdef inline bint is_same(double a, double b) noexcept
