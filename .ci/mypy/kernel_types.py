"""A plugin of mypy for kernels: their types of C, and the module that `load_kernel` gives.

mypy takes the annotation `cython.double[::1]` for an error unless a plugin gives it a type. The
names of Cython are in cython.pyi beside this file.
"""

from __future__ import annotations

import re
from collections.abc import Callable
from functools import partial
from pathlib import Path

from mypy.checker import TypeChecker
from mypy.nodes import ImportFrom, MypyFile, StrExpr
from mypy.plugin import AnalyzeTypeContext, AttributeContext, FunctionContext, Plugin
from mypy.types import AnyType, Instance, Type, TypeOfAny

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
_VIEWS = {1: "cython.View", 2: "cython.Table", 3: "cython.Block"}  # by the number of dimensions
_LOADER = "swarmd.core.kernels"
_LOADED = re.compile(r'load_kernel\(\s*"([\w.]+)"')


class KernelTypes(Plugin):
    """The types of what Cython alone understands."""

    def get_type_analyze_hook(self, fullname: str) -> Callable[[AnalyzeTypeContext], Type] | None:
        """A number of Python for one of C, and a view for an array or a pointer."""
        module, _, name = fullname.rpartition(".")
        if module != "cython":
            return None
        # A function without a result is `-> cython.int` and has no `return` at its end
        # (swarmd/core/kernels.py).
        if name == "int":
            return lambda context: AnyType(TypeOfAny.explicit)
        number = _NUMBERS.get(name.removeprefix("p_"))
        return None if number is None else partial(_type_of, number, name.startswith("p_"))

    def get_attribute_hook(self, fullname: str) -> Callable[[AttributeContext], Type] | None:
        """A part of a loaded kernel, and what the numbers of an array are.

        typeshed gives each module any attribute, and each view of memory integers.
        """
        if fullname.startswith("types.ModuleType."):
            return partial(_part, fullname.rpartition(".")[2])
        if fullname in ("numpy.ndarray.data", "numpy._ArrayOrScalarCommon.data"):
            return lambda context: AnyType(TypeOfAny.explicit)
        return None

    def get_function_hook(self, fullname: str) -> Callable[[FunctionContext], Type] | None:
        """The module that a call of `load_kernel` names."""
        return _module if fullname == f"{_LOADER}.load_kernel" else None

    def get_additional_deps(self, file: MypyFile) -> list[tuple[int, str, int]]:
        """The kernels that a file loads, as its imports."""
        if not any(isinstance(node, ImportFrom) and node.id == _LOADER for node in file.imports):
            return []
        return [(10, name, -1) for name in set(_LOADED.findall(Path(file.path).read_text()))]


def _type_of(number: str, is_pointer: bool, context: AnalyzeTypeContext) -> Type:
    kind = context.api.named_type(f"builtins.{number}", [])
    dimensions = len(context.type.args) or int(is_pointer)
    return context.api.named_type(_VIEWS[dimensions], [kind]) if dimensions else kind


def _module(context: FunctionContext) -> Type:
    name, checker = context.args[0][0], context.api
    if isinstance(name, StrExpr) and isinstance(checker, TypeChecker):
        return checker.expr_checker.module_type(checker.modules[name.value])
    return context.default_return_type


def _part(name: str, context: AttributeContext) -> Type:
    kernel = context.type.extra_attrs if isinstance(context.type, Instance) else None
    if kernel is None:
        return context.default_attr_type
    if name not in kernel.attrs:
        context.api.fail(f'Kernel "{kernel.mod_name}" has no attribute "{name}"', context.context)
    return kernel.attrs.get(name, context.default_attr_type)


def plugin(version: str) -> type[Plugin]:
    """What mypy asks for, by its version."""
    return KernelTypes
