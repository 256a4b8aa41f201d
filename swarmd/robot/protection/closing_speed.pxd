# What C needs of closing_speed.py, which has the meaning of each name.

cdef double DECISION_PERIOD, CREEP_SPEED, WALL_MARGIN, WALL_SPEED, MIN_BRAKING

cdef inline double closing_cap(double room, double braking, double unseen, double others) noexcept
cdef inline double wall_cap(double room, double braking, double unseen, double error_speed) noexcept
cdef inline double reciprocal_cap(double room, double braking, double unseen) noexcept

cdef inline double closing_deceleration(
    double linear, double lever, double slowing, double turning
) noexcept
