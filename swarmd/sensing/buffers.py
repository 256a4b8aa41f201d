"""Arrays of numbers that kernels index: new ones, and views of given ones."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:  # Cython reads this import, CPython the other
    import cython
else:
    from swarmd.core import cython_shadow as cython


@cython.cfunc
@cython.inline
@cython.exceptval(check=False)
def wrapped_index(i: cython.Py_ssize_t, n: cython.Py_ssize_t) -> cython.Py_ssize_t:
    """i modulo n, for i below 2 n, without a slow division."""
    return i - n if i >= n else i


@cython.cfunc
def view_of(values):
    """An array as a kernel reads it: in CPython a memoryview, which is faster to index."""
    return values if cython.compiled else memoryview(values)


@cython.cfunc
def new_doubles(n: cython.Py_ssize_t) -> cython.double[::1]:
    """A buffer of n doubles. Views made in one place spare the compiler a fifth of its work."""
    return memoryview(np.empty(n))


@cython.cfunc
def new_indices(n: cython.Py_ssize_t) -> cython.longlong[::1]:
    """A buffer of indices."""
    return memoryview(np.empty(n, np.int64))


@cython.cfunc
def new_flags(n: cython.Py_ssize_t) -> cython.uchar[::1]:
    """A buffer of truth values."""
    return memoryview(np.empty(n, np.uint8))
