"""Arrays that kernels read, and buffers of numbers that they keep; in CPython mostly lists.

A kernel (see `kernels.py`) that is a part of each unit that uses it. Views of memory that are
made in one place spare the compiler a fifth of its work. CPython indexes a list faster than an
array, and a memoryview faster than an array of numpy.
"""

from __future__ import annotations

import math
from array import array
from typing import TYPE_CHECKING, Any

import numpy as np

from swarmd.core import cython_shadow as cython
from swarmd.core.cython_shadow import Doubles, Indices

if TYPE_CHECKING:
    from swarmd.core.values import Array


def view(values: Array) -> Any:
    """`values` (n,) or (n, m) of any type as a kernel reads them: in CPython numbers of Python."""
    table = np.ascontiguousarray(values, np.float64)
    if not cython.compiled:
        return table.data if table.ndim > 1 else table.tolist()
    return table


def view_of(values: Array) -> Any:
    """An array of doubles itself, also to write into it."""
    return values if cython.compiled else values.data


def doubles(count: int) -> Doubles:
    """A buffer of `count` doubles, all 0."""
    return array("d", bytes(8 * count)) if cython.compiled else [0.0] * count


def scratch(count: int) -> Doubles:
    """A buffer of `count` doubles with any contents, which takes a tenth of the time."""
    return np.empty(count) if cython.compiled else [math.nan] * count


def indices(count: int) -> Indices:
    """A buffer of `count` indices, all 0."""
    return array("q", bytes(8 * count)) if cython.compiled else [0] * count


def flags(count: int) -> Indices:
    """A buffer of `count` truth values, all false."""
    return array("B", bytes(count)) if cython.compiled else [0] * count


def checked(values: Doubles, count: int) -> Doubles:
    """The values, of which a loop uses the first `count`; IndexError if there are fewer.

    A loop reads a buffer by this pointer, so that the length is checked once before the loop, and
    not at each number.
    """
    if len(values) < count:
        raise IndexError(f"{len(values)} values; expected {count}")
    if not cython.compiled:
        return values
    return cython.address(values[0])


def checked_indices(values: Indices, count: int) -> Indices:
    """As `checked`, for indices."""
    if len(values) < count:
        raise IndexError(f"{len(values)} indices; expected {count}")
    if not cython.compiled:
        return values
    return cython.address(values[0])


def wrapped_index(i: int, n: int) -> int:
    """i modulo n, for i below 2 n, without a slow division."""
    return i - n if i >= n else i
