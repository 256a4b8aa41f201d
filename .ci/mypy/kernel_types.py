"""A plugin of mypy for kernels: their types of C.

mypy takes the annotation `cython.double[::1]` for an error unless a plugin gives it a type. The
names of Cython are in swarmd/core/cython_shadow.pyi.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial

from mypy.plugin import AnalyzeTypeContext, AttributeContext, Plugin
from mypy.types import AnyType, Type, TypeOfAny

_CYTHON = "swarmd.core.cython_shadow"

_NUMBERS = {
    "double": "float",
    "const_double": "float",
    "float": "float",
    "bint": "bool",
    "longlong": "int",
    "Py_ssize_t": "int",
    "short": "int",
    "uchar": "int",
}
_VIEWS = {1: "View", 2: "_Table", 3: "_Block"}  # by the number of dimensions


class KernelTypes(Plugin):
    """The types of what Cython alone understands."""

    def get_type_analyze_hook(self, fullname: str) -> Callable[[AnalyzeTypeContext], Type] | None:
        """A number of Python for one of C, and a view for an array or a pointer."""
        module, _, name = fullname.rpartition(".")
        if module != _CYTHON:
            return None
        # A function without a result is `-> cython.int` and has no `return` at its end
        # (swarmd/core/kernels.py).
        if name == "int":
            return lambda context: AnyType(TypeOfAny.explicit)
        number = _NUMBERS.get(name.removeprefix("p_"))
        return None if number is None else partial(_type_of, number, name.startswith("p_"))

    def get_attribute_hook(self, fullname: str) -> Callable[[AttributeContext], Type] | None:
        """What the numbers of an array are: typeshed gives each view of memory integers."""
        if fullname in ("numpy.ndarray.data", "numpy._ArrayOrScalarCommon.data"):
            return lambda context: AnyType(TypeOfAny.explicit)
        return None


def _type_of(number: str, is_pointer: bool, context: AnalyzeTypeContext) -> Type:
    kind = context.api.named_type(f"builtins.{number}", [])
    dimensions = len(context.type.args) or int(is_pointer)
    return context.api.named_type(f"{_CYTHON}.{_VIEWS[dimensions]}", [kind]) if dimensions else kind


def plugin(version: str) -> type[Plugin]:
    """What mypy asks for, by its version."""
    return KernelTypes
