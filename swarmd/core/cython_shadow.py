"""Stand-ins for the names that a kernel takes from Cython, for use under CPython.

Cython's own pure-Python stand-in (`Cython.Shadow`) would make Cython a dependency of each
installation. The stand-ins behave as C in three points: the attributes of an extension type begin
at zero, no undeclared attribute exists, and C functions return NaN where Python functions raise. In
all other points a kernel must not rely on C: under CPython a division by zero raises, and a
negative index counts from the end.
"""

from __future__ import annotations

import builtins
import inspect
import math
import sys
from collections.abc import Callable
from math import atan, atan2, ceil, copysign, fabs, floor, isfinite, isinf, isnan, log
from typing import Any, TypeVar

__all__ = [
    "HUGE_VAL",
    "INFINITY",
    "NAN",
    "asin",
    "atan",
    "atan2",
    "ceil",
    "copysign",
    "cos",
    "fabs",
    "floor",
    "fmod",
    "hypot",
    "isfinite",
    "isinf",
    "isnan",
    "log",
    "remainder",
    "rint",
    "sin",
    "sqrt",
    "tan",
]

INFINITY = math.inf
HUGE_VAL = math.inf
NAN = math.nan
compiled = False


_Function = TypeVar("_Function", bound=Callable[..., Any])


class _Type:
    """A type of C."""

    def __init__(self, zero: builtins.float | None, length: builtins.int = 0) -> None:
        """`zero`: the first value of an attribute. `length`: of an array; 0 for any other type."""
        self._zero = zero
        self._length = length

    def __getitem__(self, shape: Any) -> _Type:
        """The type of an array of the length `shape`; slices give the type of a memory view."""
        return _Type(None) if isinstance(shape, slice | tuple) else _Type(self._zero, shape)

    def begin(self) -> Any:
        """The first value of an attribute of this type."""
        return [self._zero] * self._length if self._length else self._zero


class _Declared:
    """A declared attribute of an extension type."""

    def __init__(self, kind: Any) -> None:
        self.kind = kind


double = const_double = float = _Type(0.0)
int = longlong = Py_ssize_t = uchar = short = _Type(0)
bint = _Type(False)
Doubles = object  # this and the next four are views of memory
Indices = object
Table = object
IndexTable = object
Block = object

_ZERO = {"float": double, "int": int, "bool": bint}
"""By the annotation of an attribute of an extension type: the type that begins it."""


def declare(kind: Any, value: Any = None, *, visibility: str = "private") -> Any:
    """`value`; without `value`, the declaration of an attribute of an extension type."""
    return _Declared(kind) if value is None else value


def cast(kind: Any, value: builtins.float) -> builtins.int:
    """The number truncated towards zero, as C casts a double to an integer type."""
    return builtins.int(value)


def cfunc(function: _Function) -> _Function:
    """The function itself."""
    return function


ccall = cfunc
inline = cfunc
final = cfunc


def exceptval(value: Any = None, *, check: bool = False) -> Callable[[_Function], _Function]:
    """A decorator without effect: Python raises errors itself."""
    return cfunc


boundscheck = exceptval


class dataclasses:
    """The module of Cython with `dataclass`."""

    @staticmethod
    def dataclass(**directives: bool) -> Callable[[type], Any]:
        """A decorator without effect: `cclass` takes the values that begin the attributes."""
        return lambda kind: kind


def auto_pickle(value: bool) -> Callable[[type], Any]:
    """A decorator without effect: Python classes can be pickled."""
    return lambda kind: kind


def cclass(kind: type) -> Any:
    """An extension type: a class with only the declared attributes, each with its first value.

    The first value is the one that the class gives, as in a dataclass, else that of the type.
    It has one base at most. A method of the base is called as `Base.method(self)`: there is no
    `super()`, since the class that is given here is replaced.
    """
    # Only types of C are evaluated: mypy alone imports some of the others.
    declared = {
        name: eval(hint, vars(sys.modules[kind.__module__]))
        if "cython." in hint
        else _ZERO.get(hint, object)
        for name, hint in inspect.get_annotations(kind).items()
    }
    attributes = vars(kind).items()
    declared |= {name: value.kind for name, value in attributes if isinstance(value, _Declared)}
    types = {
        name: hint if isinstance(hint, _Type) else _Type(None) for name, hint in declared.items()
    }

    given = {
        name: value
        for name, value in attributes
        if name in declared and not isinstance(value, _Declared)
    }

    def new(cls: type, *_given: object, **_named: object) -> Any:
        self: Any = kind.__bases__[0].__new__(cls)  # type: ignore[call-overload]  # no metaclass
        for name, type_ in types.items():
            setattr(self, name, given.get(name, type_.begin()))
        return self

    left = {*types, "__dict__", "__weakref__"}
    members = {name: value for name, value in attributes if name not in left}
    return type(
        kind.__name__, kind.__bases__, {**members, "__slots__": tuple(types), "__new__": new}
    )


def cos(angle: builtins.float) -> builtins.float:
    """As `math.cos`; NaN of an infinite angle."""
    return math.cos(angle) if isfinite(angle) else NAN


def sin(angle: builtins.float) -> builtins.float:
    """As `math.sin`; NaN of an infinite angle."""
    return math.sin(angle) if isfinite(angle) else NAN


def tan(angle: builtins.float) -> builtins.float:
    """As `math.tan`; NaN of an infinite angle."""
    return math.tan(angle) if isfinite(angle) else NAN


def asin(value: builtins.float) -> builtins.float:
    """As `math.asin`; NaN beyond 1."""
    return math.asin(value) if -1.0 <= value <= 1.0 else NAN


def sqrt(value: builtins.float) -> builtins.float:
    """As `math.sqrt`; NaN of a negative number."""
    return math.sqrt(value) if value >= 0.0 else NAN


def fmod(value: builtins.float, divisor: builtins.float) -> builtins.float:
    """As `math.fmod`; NaN of an infinite number or for a divisor of 0."""
    return math.fmod(value, divisor) if isfinite(value) and divisor else NAN


def remainder(value: builtins.float, divisor: builtins.float) -> builtins.float:
    """As `math.remainder`; NaN of an infinite number or for a divisor of 0."""
    return math.remainder(value, divisor) if isfinite(value) and divisor else NAN


def hypot(x: builtins.float, y: builtins.float) -> builtins.float:
    """C's hypot, which `abs` of a complex number calls; `math.hypot` rounds differently."""
    try:
        return abs(complex(x, y))
    except OverflowError:
        return INFINITY


def rint(value: builtins.float) -> builtins.float:
    """The nearest whole number; halfway, the even number."""
    return builtins.float(round(value)) if isfinite(value) else value
