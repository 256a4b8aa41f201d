# What C needs of base.py, which has the meaning of each name.

cimport cython

cdef Py_ssize_t _DRAWS

cdef double _clipped(double value, double limit) noexcept

@cython.auto_pickle(False)
cdef class Bases:
    cdef readonly object before, driven, drift, inert
    cdef readonly Py_ssize_t delay_steps
    cdef Py_ssize_t _n
    cdef double _dt
    cdef double[::1] _qpos, _qvel, _applied, _qpos_before, _qvel_before
    cdef double[:, :, ::1] _delay_line
    cdef double[:, ::1] _command
    cdef Py_ssize_t _step
    cdef bint _is_capped
    cdef double[::1] _caps
    cdef double[:, ::1] _capped, _limits, _max_steps, _inert
    cdef double[::1] _grip, _grip_torque
    cdef double[:, ::1] _driven
    cdef double[::1] _shares
    cdef double[:, ::1] _drift

    @cython.locals(n=cython.Py_ssize_t)
    def __init__(self, actuation, platforms, memory, dt)

    @cython.locals(n=cython.Py_ssize_t)
    cdef int _begin_commands(self, actuation, platforms)

    @cython.locals(n=cython.Py_ssize_t)
    cdef int _begin_servos(self, platforms)

    @cython.locals(commands=cython.double[:, ::1], row=cython.Py_ssize_t, k=cython.Py_ssize_t)
    def put(self, twists)

    @cython.locals(i=cython.Py_ssize_t, row=cython.Py_ssize_t)
    def drive(self)

    @cython.locals(
        k=cython.Py_ssize_t, target=cython.double, newest=cython.Py_ssize_t,
        oldest=cython.Py_ssize_t
    )
    cdef int _aim(self, Py_ssize_t row)

    @cython.locals(
        linear=cython.double, lateral=cython.double, yaw=cython.double, c=cython.double,
        s=cython.double, error_x=cython.double, error_y=cython.double, force_x=cython.double,
        force_y=cython.double, force=cython.double, grip_share=cython.double
    )
    cdef int _push(self, Py_ssize_t row)

def _share(platform, double dt)

@cython.auto_pickle(False)
cdef class Wheels:
    cdef double[:, :, ::1] _measured
    cdef double[:, ::1] _truth, _reported
    cdef double _slip
    cdef double[:, :, ::1] _draws
    cdef Py_ssize_t[::1] _used

    @cython.locals(index=cython.Py_ssize_t, row=cython.Py_ssize_t, k=cython.Py_ssize_t)
    def read(
        self, Py_ssize_t[::1] rows, double[:, ::1] poses, double[:, ::1] twists,
        double[:, ::1] reported, double[:, ::1] measured
    )

    @cython.locals(
        x=cython.double, y=cython.double, turn=cython.double, mid_yaw=cython.double,
        c=cython.double, s=cython.double
    )
    cdef int _measure_motion(
        self, Py_ssize_t row, Py_ssize_t index, double[:, ::1] poses, double[:, ::1] measured
    )

    @cython.locals(mid_yaw=cython.double, c=cython.double, s=cython.double)
    cdef int _add_motion(self, Py_ssize_t row, double linear, double turn, double lateral)

    @cython.locals(k=cython.Py_ssize_t)
    cdef int _draw_slips(self, Py_ssize_t row)

    @cython.locals(m=cython.double[:, :, ::1])
    cdef int _measure(
        self, Py_ssize_t row, Py_ssize_t index, double linear, double angular, double lateral,
        double[:, ::1] measured
    )
