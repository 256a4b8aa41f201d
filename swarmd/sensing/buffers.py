"""Arrays of numbers that kernels index: new ones, and views of given ones."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

if TYPE_CHECKING:  # Cython reads this import, CPython the other
    import cython

    from swarmd.core.values import Array
else:
    from swarmd.core import cython_shadow as cython


@cython.cfunc
@cython.inline
@cython.exceptval(check=False)
def wrapped_index(i: cython.Py_ssize_t, n: cython.Py_ssize_t) -> cython.Py_ssize_t:
    """i modulo n, for i below 2 n, without a slow division."""
    return i - n if i >= n else i


@cython.cfunc
def view_of(values: Array) -> Any:
    """An array as a kernel reads it: in CPython a memoryview, which is faster to index."""
    return values if cython.compiled else values.data


@cython.cfunc
def new_doubles(n: cython.Py_ssize_t) -> cython.double[::1]:
    """A buffer of n doubles. Views made in one place spare the compiler a fifth of its work."""
    buffer: cython.double[::1] = np.empty(n).data
    return buffer


@cython.cfunc
def new_indices(n: cython.Py_ssize_t) -> cython.longlong[::1]:
    """A buffer of indices."""
    buffer: cython.longlong[::1] = np.empty(n, np.int64).data
    return buffer


@cython.cfunc
def new_flags(n: cython.Py_ssize_t) -> cython.uchar[::1]:
    """A buffer of truth values."""
    buffer: cython.uchar[::1] = np.empty(n, np.uint8).data
    return buffer
