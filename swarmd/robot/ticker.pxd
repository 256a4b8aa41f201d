# What C needs of ticker.py, which has the meaning of each name.

cimport cython

cdef double _MAX_HOLD_TIME, _STATUS_PERIOD, _STALL_TIMEOUT
cdef object _RUNNING, _IDLE, _Actions, _HostInput, _Step, _Stepped, _no_permit, _Steered, _Twist
cdef object _Avoided, _WayState, _stand
cdef double _STALE_MARGIN

@cython.locals(
    linear=cython.double, angular=cython.double, lateral=cython.double, bearing=cython.double,
    distance=cython.double
)
cdef int _check_steered(steered) except? -1

@cython.final
cdef class DutyCycle:
    cdef readonly Py_ssize_t decisions, active

cdef class Ticker:
    cdef public object decision
    cdef public double decided_at
    cdef public InputAges _sensors
    cdef public PatternRun _run
    cdef public object _lifecycle
    cdef public StateMachine _machine
    cdef public object _kept_goals, _requests, _protection, _steering
    cdef public DutyCycle _duty
    cdef public object _log, _standing, _status_watch, _peer_faults
    cdef public double _last_tick, _due_at, _quiet_until, _published_at
    cdef public bint _is_status_due
    cdef Py_ssize_t _restarts
    cdef public bint _is_off_command
    cdef public dict _handlers
    cdef public object _hold
    def step(self, input, double now)
    cpdef Effects _begin(self, double now)
    def _on_tick(self, one, double now)

    @cython.locals(is_quiet=cython.bint)
    cdef _tick(self, double now)

    @cython.locals(has_status=cython.bint)
    cdef _settled_after(self, Effects effects)

    @cython.locals(is_driven=cython.bint, delay=cython.double)
    cdef _checked_hold(self, Effects effects)
    cdef _host_command(self, Effects effects)

    @cython.locals(is_recent=cython.bint)
    cdef bint _must_publish(self, double now)
    cdef int _watch_standing(self, double now)

    @cython.locals(has_hand=cython.bint, is_idle=cython.bint, is_stopped=cython.bint)
    cdef _actions(self, Effects effects, decision, host_command, bint has_status)
    cdef _look_ahead(self, double now)

    @cython.locals(due=cython.double)
    cdef double _lifecycle_due_at(self)

    @cython.locals(asks=cython.bint)
    def _on_scan(self, one, double now)
    cdef _share(self, context, bint asks)

    @cython.locals(restarts=cython.Py_ssize_t)
    cdef _look_at_stamps(self, double now)

    @cython.locals(is_off_command=cython.bint, blocked_bearing=cython.double)
    cpdef _take_odometry(self, odometry, double now)
    cpdef _on_message(self, one, double now)

    @cython.locals(is_running=cython.bint)
    cpdef _decide(self, hold, double now)
    def wake_at(self, double now)

@cython.locals(i=cython.Py_ssize_t, row=cython.Py_ssize_t)
def tick_many(robots, rows, double[:, ::1] commands, double now)

@cython.locals(i=cython.Py_ssize_t)
def odometry_many(robots, readings, double now)

def message_many(robots, message, double now)

@cython.locals(asks=cython.bint)
def kin_many(robots, one, double now)
