# What C needs of angles.py, which has the meaning of each name.

cdef double PI, TURN

cdef inline double mod_turn(double angle) noexcept
cdef inline double wrap(double angle) noexcept
cdef inline double angle_between(double first, double second) noexcept
cdef inline double difference(double to, double origin) noexcept
