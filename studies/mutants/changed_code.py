"""The functions that a mutant changes, and their change in a process that has imported them."""

from __future__ import annotations

import gc
import inspect
import os
from collections.abc import Iterator, Mapping, Sequence
from types import CodeType, FunctionType
from typing import TypeAlias

Place: TypeAlias = tuple[str, str, int]
"""A file, and in it the qualified name and the first line of a function."""


def changed_functions(source: str, mutated: str, file: str) -> Mapping[Place, CodeType] | None:
    """The new code of the changed functions; None if anything else is changed, too.

    A function is one of the module or of a class; what is defined within it is a part of it.
    """
    old = compile(source, file, "exec", dont_inherit=True)
    new = compile(mutated, file, "exec", dont_inherit=True)
    if _frame(old) != _frame(new):
        return None
    pairs = zip(_functions(old), _functions(new), strict=True)
    return {(file, a.co_qualname, a.co_firstlineno): b for a, b in pairs if a != b}


def functions_of(files: Sequence[str]) -> Mapping[Place, Sequence[FunctionType]]:
    """The functions of some files in this process; a decorator may have made a second one."""
    wanted = frozenset(files)
    real: dict[str, str] = {}
    found: dict[Place, list[FunctionType]] = {}
    for function in gc.get_objects():
        if type(function) is not FunctionType:
            continue
        code = function.__code__
        file = code.co_filename
        if file not in real:
            real[file] = os.path.realpath(file)  # a folder may be a link (swarmd/drivers)
        if real[file] in wanted:
            place = real[file], code.co_qualname, code.co_firstlineno
            found.setdefault(place, []).append(function)
    return found


def outermost(name: str) -> str:
    """The function of the module or of a class in which code of this qualified name is.

    `outermost("A.f.<locals>.<lambda>") == "A.f"`.
    """
    return name.partition(".<locals>")[0]


def _functions(code: CodeType) -> Iterator[CodeType]:
    """The functions of a module or a class, and those of its classes."""
    for part in code.co_consts:
        if isinstance(part, CodeType):
            if part.co_flags & inspect.CO_OPTIMIZED:
                yield part
            else:
                yield from _functions(part)


def _frame(code: CodeType) -> tuple[object, ...]:
    """What the code of a module or a class does beyond the functions in it."""
    parts: list[object] = []
    for part in code.co_consts:
        if not isinstance(part, CodeType):
            parts.append((type(part), repr(part)))
        elif part.co_flags & inspect.CO_OPTIMIZED:
            parts.append((part.co_qualname, part.co_firstlineno, part.co_freevars))
        else:
            parts.append(_frame(part))
    return code.co_code, code.co_names, tuple(parts)
