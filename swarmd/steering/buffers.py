"""How kernels of steering read arrays and keep numbers: buffers of C, or lists of CPython.

A kernel (see `core/kernels.py`), part of the library of steering.
"""

from __future__ import annotations

import math
from array import array
from typing import TYPE_CHECKING, Any

import numpy as np

if TYPE_CHECKING:  # Cython reads this import, CPython the other
    import cython

    from swarmd.core.values import Array
else:
    from swarmd.core import cython_shadow as cython
if cython.compiled:
    from cython.cimports.libc.math import fabs
else:
    from swarmd.core.cython_shadow import fabs


@cython.cfunc
def numbers(values: Array) -> Any:
    """`values` (n,) as the kernel reads them: in CPython as numbers of Python."""
    values = np.ascontiguousarray(values, np.float64)
    return values if cython.compiled else values.tolist()


@cython.cfunc
def rows(values: Array) -> Any:
    """`values` (n, m) as the kernel reads them: in CPython a memoryview, faster than an array."""
    values = np.ascontiguousarray(values, np.float64)
    return values if cython.compiled else values.data


@cython.cfunc
def doubles(count: cython.Py_ssize_t) -> cython.double[::1]:
    """A buffer of `count` doubles, all 0; of numbers of Python in CPython.

    Views that are made in one place spare the compiler a part of its work.
    """
    return array("d", bytes(8 * count)) if cython.compiled else [0.0] * count


@cython.cfunc
def scratch(count: cython.Py_ssize_t) -> cython.double[::1]:
    """A buffer of `count` doubles with any contents, which takes a tenth of the time."""
    return np.empty(count) if cython.compiled else [math.nan] * count


def places(count: cython.Py_ssize_t) -> Any:
    """A buffer of `count` whole numbers."""
    return array("q", bytes(8 * count)) if cython.compiled else [0] * count


@cython.cfunc
def speed_of(linear: cython.double, lateral: cython.double) -> cython.double:
    """The speed in m/s of a twist by `math.hypot`, which rounds differently from C's hypot.

    Most bases do not move sideways, and need no call of Python.
    """
    return fabs(linear) if lateral == 0.0 else math.hypot(linear, lateral)
