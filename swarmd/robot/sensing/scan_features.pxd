# What C needs of scan_features.py, which has the meaning of each name.

cimport cython

cdef double _UNSEEN

@cython.locals(
    n=cython.Py_ssize_t, least=cython.double, lowest=cython.double, index=cython.Py_ssize_t,
    is_sector=cython.bint, i=cython.Py_ssize_t
)
def nearest(scan, double bearing, double half_width)

@cython.locals(given=cython.const_double[::1], out=cython.double[:, ::1], i=cython.Py_ssize_t)
def unit_vectors(bearings)

@cython.locals(point_count=cython.Py_ssize_t)
def closest_points(scan, double within, Py_ssize_t count)

@cython.locals(ray_count=cython.Py_ssize_t, i=cython.Py_ssize_t, k=cython.Py_ssize_t)
cdef bint _store_nearest_rays(ScanLayout layout, Py_ssize_t count, double range_min, double within)

@cython.locals(point_count=cython.Py_ssize_t, k=cython.Py_ssize_t)
cdef Py_ssize_t _store_local_minima(ScanLayout layout, Py_ssize_t count)

@cython.locals(point_count=cython.Py_ssize_t, k=cython.Py_ssize_t)
cdef Py_ssize_t _store_nearest_sectors(ScanLayout layout, Py_ssize_t count)

cdef int _store_point(ScanLayout layout, Py_ssize_t place, Py_ssize_t sector)

@cython.boundscheck(False)
@cython.locals(
    ray_count=cython.Py_ssize_t, first=cython.Py_ssize_t, last=cython.Py_ssize_t,
    i=cython.Py_ssize_t, k=cython.Py_ssize_t
)
def clusters(scan, double within, double jump, double grazing)

@cython.boundscheck(False)
@cython.locals(ranges=cython.double[::1], count=cython.Py_ssize_t, i=cython.Py_ssize_t)
cdef bint _store_ranges(ScanLayout layout, double range_min, double within)

@cython.boundscheck(False)
@cython.locals(count=cython.Py_ssize_t, first=cython.Py_ssize_t, i=cython.Py_ssize_t)
cdef Py_ssize_t _store_last_rays(ScanLayout layout, double jump)

@cython.locals(n=cython.Py_ssize_t, begin=cython.Py_ssize_t, end=cython.Py_ssize_t)
cdef _object(ScanLayout layout, Py_ssize_t first, Py_ssize_t last, double lowest)
