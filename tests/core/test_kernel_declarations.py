"""A kernel and the `.pxd` beside it give the compiler one text."""

from __future__ import annotations

import ast
from pathlib import Path

import pytest

from swarmd.core.kernel_types import VIEWS, typed
from swarmd.core.kernels import KERNELS, files_of
from tests.support.kernel_forms import typed_text

ROOT = Path(__file__).resolve().parents[2]
TYPED = [name for name in KERNELS if (ROOT / files_of(name)[1]).exists()]

SOURCE = '''\
"""A kernel."""

from __future__ import annotations

from swarmd.core import cython_shadow as cython
from swarmd.core.cython_shadow import Doubles

LIMIT = (
    1.0
)
_make = dict


@cython.cclass
class Row:
    """A row."""

    x: float  # m
    places: Doubles
    text: str
    seen: float

    def put(self, x: float, name: str, *, count: int = 0) -> None:
        """Put it."""
        if count == 0:
            return
        for k in range(count):
            self.x = x


def is_near(row: Row, places: Doubles) -> bool:
    near: float  # m
    near = row.x
    return near < LIMIT


def _read(values: object) -> None:
    """Read it."""
    given: Doubles = values
'''
DECLARED = """\
# Types.
cimport cython

cdef double LIMIT
cdef object _make

@cython.final
@cython.auto_pickle(False)
cdef class Row:
    cdef double x
    cdef const double[::1] places
    cdef readonly object text
    cdef public double seen

    @cython.locals(k=cython.Py_ssize_t)
    cdef int put(
        self, double x, name,
        Py_ssize_t count=*
    ) except? -1

@cython.locals(near=cython.double)
cdef inline bint is_near(Row row, double* places) except -1

@cython.locals(given=cython.double[:, ::1])
def _read(values)
"""
WANTED = '''\
"""A kernel."""

from __future__ import annotations

from swarmd.core import cython_shadow as cython
from swarmd.core.cython_shadow import Doubles

LIMIT = (
    cython.declare(cython.double, 1.0)
)
_make = cython.declare(object, dict)


@cython.final
@cython.auto_pickle(False)
@cython.cclass
class Row:
    """A row."""

    x: cython.double  # m
    places: cython.const_double[::1]
    text: str = cython.declare(object, visibility="readonly")
    seen = cython.declare(cython.double, visibility="public")

    @cython.cfunc
    @cython.exceptval(-1)
    def put(self, x: cython.double, name: str, *, count: cython.Py_ssize_t = 0) -> cython.int:
        """Put it."""
        k: cython.Py_ssize_t
        if count == 0:
            return 0
        for k in range(count):
            self.x = x


@cython.cfunc
@cython.inline
@cython.exceptval(-1, check=False)
def is_near(row: Row, places: cython.p_double) -> cython.bint:
    near: cython.double  # m
    near = row.x
    return near < LIMIT


def _read(values: object) -> None:
    """Read it."""
    given: cython.double[:, ::1] = values
'''


def test_the_compiler_reads_a_kernel_with_the_types_of_its_declarations() -> None:
    assert typed(SOURCE, DECLARED, "kernel").text == WANTED


def test_each_line_knows_its_line_of_the_source() -> None:
    """So a traceback of compiled code names the line that a reader sees."""
    made = typed(SOURCE, DECLARED, "kernel")
    lines = made.text.splitlines()
    wanted = SOURCE.splitlines()
    pairs = {line: wanted[made.lines[number] - 1] for number, line in enumerate(lines)}
    assert pairs["        for k in range(count):"] == "        for k in range(count):"
    assert pairs["    @cython.exceptval(-1)"] == pairs["    @cython.cfunc"]
    assert "def put" in pairs["    @cython.cfunc"]
    assert made.lines[-1] == len(wanted)


def test_a_kernel_without_declarations_stays_as_it_is() -> None:
    made = typed(SOURCE, "", "kernel")
    assert (made.text, made.lines[:3]) == (SOURCE, [1, 2, 3])


@pytest.mark.parametrize(
    ("old", "new", "named"),
    [
        ("cdef double LIMIT", "cdef double LIMITS", "LIMITS"),
        ("cdef double x", "cdef double y", "Row has no y"),
        ("cdef double x", "cdef Py_ssize_t x", "Row.x is no int"),
        ("cdef class Row", "cdef class Rows", "Rows"),
        ("is_near(", "are_near(", "are_near"),
        ("bint is_near", "double is_near", "is_near gives no float"),
        ("double x, name", "double y, name", "Row.put"),
        ("double x, name", "Py_ssize_t x, name", "Row.put(x) is no int"),
        ("(k=cython.", "(i=cython.", "Row.put has no i"),
        ("def _read", "cfd _read", "cfd _read"),
    ],
)
def test_declarations_of_what_is_not_so_are_refused(old: str, new: str, named: str) -> None:
    assert old in DECLARED
    with pytest.raises(ValueError, match="declar") as refused:
        typed(SOURCE, DECLARED.replace(old, new, 1), "kernel")
    assert named in str(refused.value)


@pytest.mark.parametrize("name", TYPED, ids=lambda name: name.rpartition(".")[2])
def test_what_needs_a_type_of_c_has_it_in_the_declarations(name: str) -> None:
    """Else C would keep an object of Python there: slow, and None where a number begins as 0."""
    text = typed_text(name)
    tree = ast.parse(text)
    classes = [node for node in tree.body if isinstance(node, ast.ClassDef)]
    kept = [
        f"{owner.name}.{ast.unparse(field.target)}"
        for owner in classes
        if "cython.cclass" in map(ast.unparse, owner.decorator_list)
        for field in owner.body
        if isinstance(field, ast.AnnAssign)
        and field.value is None
        and ast.unparse(field.annotation) in ("float", "int", "bool")
    ]
    words = {
        ast.unparse(node)
        for node in ast.walk(tree)
        if isinstance(node, ast.Name) and node.id in VIEWS.values()
    }
    assert (kept, words) == ([], set())
