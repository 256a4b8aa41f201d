"""How kernels of steering read arrays and keep numbers: buffers of C, or lists of CPython.

A kernel (see `core/kernels.py`), part of the library of steering.
"""

from __future__ import annotations

from array import array
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:  # Cython reads this import, CPython the other
    import cython
else:
    from swarmd.core import cython_shadow as cython


@cython.cfunc
def numbers(values):
    """`values` (n,) as the kernel reads them: in CPython as numbers of Python."""
    values = np.ascontiguousarray(values, np.float64)
    return values if cython.compiled else values.tolist()


@cython.cfunc
def rows(values):
    """`values` (n, m) as the kernel reads them: in CPython a memoryview, faster than an array."""
    values = np.ascontiguousarray(values, np.float64)
    return values if cython.compiled else memoryview(values)


@cython.cfunc
def doubles(count: cython.Py_ssize_t) -> cython.double[::1]:
    """A buffer of `count` doubles, all 0; of numbers of Python in CPython.

    Views that are made in one place spare the compiler a part of its work.
    """
    return array("d", bytes(8 * count)) if cython.compiled else [0.0] * count
