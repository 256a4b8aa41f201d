"""Comparisons of numbers with defined results for NaN. Part of the unit of barrier.py."""

from __future__ import annotations


def maximum(a: float, b: float) -> float:
    """The greater number; NaN if either is NaN."""
    return a if (a > b) | (a != a) else b


def at_least(value: float, least: float) -> float:
    """As `maximum` for a `least` that is not NaN: one instruction in place of six."""
    return least if least > value else value


def is_same(a: float, b: float) -> bool:
    """True if the numbers are equal, or both NaN."""
    return a == b or (a != a and b != b)
