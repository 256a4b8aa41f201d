"""What CPython runs in place of Cython."""

from __future__ import annotations

import math
from collections.abc import Callable

import pytest

from swarmd.core import cython_shadow as cython

DECLARED = {
    "count": "cython.Py_ssize_t",
    "is_due": "cython.bint",
    "way": "cython.double[::1]",
    "places": "cython.double[2]",
    "name": "Absent | None",  # a type that no interpreter sees
}
READABLE = cython.declare(cython.double, visibility="readonly")
Counter = cython.cclass(type("Counter", (), {"__annotations__": DECLARED, "seen": READABLE}))


def test_attributes_of_an_extension_type_begin_at_zero() -> None:
    one, other = Counter(), Counter()
    assert (one.count, one.way, one.places, one.name, one.seen) == (0, None, [0.0, 0.0], None, 0.0)
    assert one.is_due is False
    one.places[0] = 1.0
    assert other.places == [0.0, 0.0]


def test_attributes_of_an_extension_type_begin_at_the_value_that_its_class_gives() -> None:
    begins = {"__annotations__": {"gain": "cython.double", "share": "cython.double"}, "gain": 2.5}
    one = cython.cclass(type("Begun", (), begins))()
    assert (one.gain, one.share) == (2.5, 0.0)


def test_an_extension_type_has_no_attribute_that_is_not_declared() -> None:
    with pytest.raises(AttributeError):
        Counter().cuont = 1


@pytest.mark.parametrize(
    ("function", "values"),
    [
        (cython.cos, (math.inf,)),
        (cython.sin, (-math.inf,)),
        (cython.tan, (math.inf,)),
        (cython.asin, (1.5,)),
        (cython.sqrt, (-1.0,)),
        (cython.fmod, (math.inf, 1.0)),
        (cython.fmod, (1.0, 0.0)),
        (cython.remainder, (math.inf, 1.0)),
        (cython.remainder, (1.0, 0.0)),
    ],
)
def test_functions_of_c_give_nan_where_those_of_python_raise(
    function: Callable[..., float], values: tuple[float, ...]
) -> None:
    assert math.isnan(function(*values))


@pytest.mark.parametrize(("value", "whole"), [(0.5, 0.0), (1.5, 2.0), (-0.7, -1.0)])
def test_rint_rounds_halves_to_even(value: float, whole: float) -> None:
    assert cython.rint(value) == whole
