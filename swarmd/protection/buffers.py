"""Buffers of numbers of the kernel `barrier`, and comparisons with defined results for NaN.

Part of the library of barrier.py. A loop reads a buffer by the pointer that `checked` gives. So the
length is checked once before the loop, and not at each number.
"""

from __future__ import annotations

from array import array
from typing import TYPE_CHECKING, Any

import numpy as np

from swarmd.core.values import Array

if TYPE_CHECKING:  # Cython reads this import, CPython the other one
    import cython
else:
    from swarmd.core import cython_shadow as cython


def view(values: Array) -> Any:
    """`values` (n,) or (n, m) as the kernel reads them: in CPython as numbers of Python."""
    table = np.ascontiguousarray(values, np.float64)
    if not cython.compiled:
        return table.data if table.ndim > 1 else table.tolist()
    return table


def doubles(count: cython.Py_ssize_t) -> Any:
    """A buffer of `count` doubles, all 0."""
    return array("d", bytes(8 * count)) if cython.compiled else [0.0] * count


def indices(count: cython.Py_ssize_t) -> Any:
    """A buffer of `count` indices, all 0."""
    return array("q", bytes(8 * count)) if cython.compiled else [0] * count


@cython.cfunc
@cython.inline
def checked(values: cython.double[::1], count: cython.Py_ssize_t) -> cython.p_double:
    """The values, of which a loop uses the first `count`; IndexError if there are fewer."""
    if len(values) < count:
        raise IndexError(f"{len(values)} values; expected {count}")
    if not cython.compiled:
        return values
    return cython.address(values[0])


@cython.cfunc
@cython.inline
def checked_indices(values: cython.longlong[::1], count: cython.Py_ssize_t) -> cython.p_longlong:
    """As `checked`, for indices."""
    if len(values) < count:
        raise IndexError(f"{len(values)} indices; expected {count}")
    if not cython.compiled:
        return values
    return cython.address(values[0])


@cython.cfunc
def take(
    values: cython.double[::1],
    order: cython.longlong[::1],
    count: cython.Py_ssize_t,
    into: cython.double[::1],
    begin: cython.Py_ssize_t,
) -> None:
    """Put the values at the first `count` indices of `order` into a buffer, from `begin` on."""
    i: cython.Py_ssize_t
    index: cython.p_longlong = checked_indices(order, count)
    given: cython.p_double = checked(values, count)
    to: cython.p_double = checked(into, begin + count)
    for i in range(count):
        to[begin + i] = given[index[i]]


@cython.cfunc
@cython.inline
@cython.exceptval(check=False)
def maximum(a: cython.double, b: cython.double) -> cython.double:
    """The greater number; NaN if either is NaN."""
    return a if (a > b) | (a != a) else b


@cython.cfunc
@cython.inline
@cython.exceptval(check=False)
def at_least(value: cython.double, least: cython.double) -> cython.double:
    """As `maximum` for a `least` that is not NaN: one instruction in place of six."""
    return least if least > value else value


@cython.cfunc
@cython.inline
@cython.exceptval(check=False)
def is_same(a: cython.double, b: cython.double) -> cython.bint:
    """True if the numbers are equal, or both NaN."""
    return a == b or (a != a and b != b)
