# What C needs of input_ages.py, which has the meaning of each name.

cimport cython

cdef double _ODOMETRY_TIMEOUT, _NEIGHBOR_TIMEOUT, _KIN_TIMEOUT, _AGE_UPDATE_PERIOD
cdef object _Context, _Inputs

@cython.final
cdef class Hold:
    cdef public object reason
    cdef public double begins, until
    cdef public bint ends_run
    def __init__(self, reason, double begins=*)

cdef class InputAges:
    cdef public object odometry, scan, readings, detections, own_pose, scan_delay
    cdef public bint is_driver_up
    cdef public tuple holds
    cdef public Hold lost_hold, base_hold, hazard_hold, delay_hold, scan_hold, ring_hold
    cdef public Hold odometry_hold, peers_hold, pose_hold
    cdef public double permitted_delay, _scan_at, _odometry_at, _added
    cdef public bint _is_late
    cdef public double _stale_after, _max_delay
    cdef public object _ring, _places, _anchors, kin, _make_kin
    cdef public bint _is_partial
    cdef public double _middle, _radius, _kin_until
    cdef public object _teller
    cdef public bint _is_new_scan
    cdef public object _history, _conditioner, _bad_odometry, inbox
    cdef public tuple _neighbors
    cdef public double _neighbors_at
    cdef public tuple _aged
    cdef public double _renewals
    cdef public object _context
    cdef double _context_at
    cpdef on_odometry(self, odometry, double now)
    cpdef on_kin(self, robot, message, double now)
    cpdef ask_kin(self, double now)
    cpdef neighbors(self, double now)
    cpdef inputs(self, double now, double dt)
    cpdef context(self, double now)
    cpdef hold(self, double now)
    cpdef hold_due_at(self, double now)
    cpdef stale_at(self)
    cpdef permit_delay(self, double seconds)

    @cython.locals(is_permitted=cython.bint)
    cpdef time_scan(self)
