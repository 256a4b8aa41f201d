"""Comparisons of numbers with defined results for NaN. Part of the unit of barrier.py."""

from __future__ import annotations

from swarmd.core import cython_shadow as cython


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
