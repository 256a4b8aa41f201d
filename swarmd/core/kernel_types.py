"""The types of C of a kernel, which stand in a `.pxd` beside its file.

The `.py` reads as Python. The `.pxd` has, in Cython's syntax, what C needs beyond that: the types
of constants, fields, arguments, results and local variables, and what a function does with errors.
A function of Python has its types in a line `def`, which Cython itself does not know in a `.pxd`.

`typed` puts both together, as the file that the compiler reads: a kernel in pure-Python mode. With
Cython's own use of a `.pxd`, each access to a field of an argument would ask for None, each
function would be exported, and a class could not name its fields: that took 6.8 % more instructions
for one file.

setup.py runs this file alone, so it imports no other module of swarmd.
"""

from __future__ import annotations

import ast
import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field

NUMBERS: Mapping[str, tuple[str, str]] = {
    "double": ("double", "float"),
    "const double": ("const_double", "float"),
    "float": ("float", "float"),
    "bint": ("bint", "bool"),
    "Py_ssize_t": ("Py_ssize_t", "int"),
    "long long": ("longlong", "int"),
    "int": ("int", "int"),
    "short": ("short", "int"),
    "unsigned char": ("uchar", "int"),
}
"""By a number of C: its name in Cython's pure-Python mode, and the type of Python."""

VIEWS: Mapping[tuple[str, int], str] = {
    ("float", 1): "Doubles",
    ("int", 1): "Indices",
    ("float", 2): "Table",
    ("int", 2): "IndexTable",
    ("float", 3): "Block",
}
"""What a `.py` calls a view, an array or a pointer: by its numbers and its dimensions."""

IMPORT = "from swarmd.core import cython_shadow as cython"

_TYPE = re.compile(r"(.*?)(\[.*\]|\*)?")
_ARGUMENT = re.compile(r"(?:(.*[\s\]*]))?(\w+)(?:=\*)?")
_CLASS = re.compile(r"cdef class (\w+)(?:\(\w+\))?:")
_FUNCTION = re.compile(
    r"(def|cdef|cpdef)\s(inline\s)?(?:(.*?[\s\]*]))??(\w+)\((.*)\)"
    r"(?: (noexcept)| except(\?)? (-\d+(?:\.\d+)?))?"
)
_FIELDS = re.compile(r"cdef (?:(public|readonly) )?(.*)")


@dataclass
class Declared:
    """What a `.pxd` says of a function."""

    decorators: list[str]
    result: str
    arguments: dict[str, str]
    local_types: dict[str, str]  # as in pure-Python mode


@dataclass
class Declarations:
    """What a `.pxd` says of a module, or of a class in it. Types as the `.pxd` has them."""

    decorators: list[str] = field(default_factory=list)
    variables: dict[str, tuple[str, str]] = field(default_factory=dict)  # type and visibility
    functions: dict[str, Declared] = field(default_factory=dict)
    classes: dict[str, Declarations] = field(default_factory=dict)


@dataclass
class Typed:
    """A kernel as the compiler reads it."""

    text: str
    lines: list[int]
    """For each line of the text, counted from 0, the line of the `.py`, counted from 1."""


def pure_type(text: str) -> str:
    """A type of C as pure-Python mode names it; any other type as it is."""
    match = _TYPE.fullmatch(text.strip())
    assert match
    base = match[1].strip()
    kind = match[2] or ""
    if base not in NUMBERS:
        return text.strip()
    name = NUMBERS[base][0]
    return f"cython.p_{name}" if kind == "*" else f"cython.{name}{kind}"


def python_type(text: str) -> str:
    """The type of Python that a `.py` has for a type of C; empty for any other type."""
    match = _TYPE.fullmatch(text.strip())
    assert match
    base = match[1].strip()
    kind = match[2] or ""
    if base not in NUMBERS:
        return ""
    number = NUMBERS[base][1]
    return VIEWS[number, kind.count(",") + 1] if kind else number


def declarations(text: str) -> Declarations:
    """What a `.pxd` says; ValueError with the line that is not understood."""
    module = Declarations()
    place = module
    decorators: list[str] = []
    for line in _statements(text):
        statement = line.strip()
        if line == statement:
            place = module
        if statement.startswith("@"):
            decorators.append(statement[1:])
        elif match := _CLASS.fullmatch(statement):
            place = module.classes[match[1]] = Declarations(decorators)
            decorators = []
        elif match := _FUNCTION.fullmatch(statement):
            place.functions[match[4]] = _function(match, decorators)
            decorators = []
        elif match := _FIELDS.fullmatch(statement):
            first, *others = _split(match[2])
            kind, _, name = first.rpartition(" ")
            for one in (name, *others):
                place.variables[one] = (kind, match[1] or "")
        elif statement not in ("cimport cython", "pass"):
            raise ValueError(f"{statement!r} is no declaration of a .pxd")
    return module


def _statements(text: str) -> Iterator[str]:
    """The statements of a `.pxd`, each in one line, without comments."""
    found = ""
    for line in text.splitlines():
        bare = line.partition("#")[0].rstrip()
        found += bare.strip() if found else bare
        if found.count("(") > found.count(")"):
            found += " " if found.endswith(",") else ""
        elif found:
            yield re.sub(r",\s*\)", ")", found)
            found = ""


def _split(text: str) -> list[str]:
    """The parts between commas that are in no bracket."""
    return [part.strip() for part in re.split(r",(?![^\[]*\])", text) if part.strip()]


def _function(match: re.Match[str], decorators: list[str]) -> Declared:
    kind, inline, result, _, arguments, noexcept, maybe, value = match.groups()
    local_types: dict[str, str] = {}
    others = []
    for text in decorators:
        if text.startswith("cython.locals("):
            call = ast.parse(text, mode="eval").body
            assert isinstance(call, ast.Call)
            local_types = {str(one.arg): ast.unparse(one.value) for one in call.keywords}
        else:
            others.append(text)
    if kind != "def":
        others.append("cython.ccall" if kind == "cpdef" else "cython.cfunc")
    if inline:
        others.append("cython.inline")
    if noexcept:
        others.append("cython.exceptval(check=False)")
    elif value:
        others.append(f"cython.exceptval({value}{'' if maybe else ', check=False'})")
    pairs = {}
    for part in _split(arguments):
        found = _ARGUMENT.fullmatch(part)
        if found is None:
            raise ValueError(f"{part!r} is no argument of a .pxd")
        pairs[found[2]] = (found[1] or "").strip()
    return Declared(others, (result or "").strip(), pairs, local_types)


class _Weaver:
    """Puts declarations into the text of a kernel."""

    def __init__(self, source: str, name: str) -> None:
        self._name = name
        self._lines = source.encode().splitlines(keepends=True)
        self._changes: list[tuple[int, int, int, bytes]] = []  # line, begin, end, text
        self._inserted: dict[int, list[str]] = {}  # lines before a line

    def weave(self, tree: ast.Module, declared: Declarations) -> Typed:
        self._weave_body(tree.body, declared, "")
        if IMPORT.encode() + b"\n" not in self._lines:
            first = next(
                node.lineno
                for node in tree.body
                if (isinstance(node, ast.Import | ast.ImportFrom) and _module(node) != "__future__")
                or not isinstance(node, ast.ImportFrom | ast.Expr)
            )
            self._inserted.setdefault(first, []).insert(0, IMPORT)
        for line, begin, end, new in sorted(self._changes, reverse=True):
            old = self._lines[line - 1]
            self._lines[line - 1] = old[:begin] + new + old[end:]
        text = ""
        lines: list[int] = []
        for number, one in enumerate(self._lines, 1):
            before = self._inserted.get(number, [])
            text += "".join(f"{added}\n" for added in before) + one.decode()
            lines += [number] * (len(before) + 1)
        return Typed(text, lines)

    def _weave_body(self, body: Sequence[ast.stmt], declared: Declarations, owner: str) -> None:
        functions = {one.name: one for one in body if isinstance(one, ast.FunctionDef)}
        classes = {one.name: one for one in body if isinstance(one, ast.ClassDef)}
        variables = _assigners(body)
        self._all_there(owner, declared.functions, functions)
        self._all_there(owner, declared.classes, classes)
        self._all_there(owner, declared.variables, variables)
        for name, (kind, visibility) in declared.variables.items():
            if owner:
                self._weave_field(f"{owner}.{name}", variables[name], kind, visibility)
            else:
                self._weave_constant(variables[name], kind)
        for name, inside in declared.classes.items():
            node = classes[name]
            self._decorate(node, inside.decorators)
            self._weave_body(node.body, inside, name)
        for name, function in declared.functions.items():
            self._weave_function(f"{owner}.{name}".lstrip("."), functions[name], function)

    def _all_there(
        self, owner: str, wanted: Mapping[str, object], there: Mapping[str, object]
    ) -> None:
        if absent := sorted(wanted.keys() - there.keys()):
            raise self._error(owner or "the module", f"has no {', '.join(absent)}")

    def _error(self, place: str, text: str) -> ValueError:
        return ValueError(f"{self._name}: {place} {text}, which its .pxd declares")

    def _weave_constant(self, node: ast.AST, kind: str) -> None:
        assert isinstance(node, ast.Assign | ast.AnnAssign)
        value = node.value
        assert value is not None
        assert value.end_lineno is not None
        assert value.end_col_offset is not None
        head = f"cython.declare({pure_type(kind)}, ".encode()
        self._changes.append((value.lineno, value.col_offset, value.col_offset, head))
        end = value.end_col_offset
        self._changes.append((value.end_lineno, end, end, b")"))

    def _weave_field(self, place: str, node: ast.AST, kind: str, visibility: str) -> None:
        if not isinstance(node, ast.AnnAssign):
            raise self._error(place, "has no annotation")
        wanted = python_type(kind)
        if wanted and ast.unparse(node.annotation) != wanted:
            raise self._error(place, f"is no {wanted}")
        if wanted and not visibility:
            self._annotate(node.annotation, pure_type(kind))
            return
        stated = f', visibility="{visibility}"' if visibility else ""
        end = node.annotation.end_col_offset
        begin = node.annotation.col_offset
        if wanted:  # without an annotation, as Cython takes each as a type
            assert isinstance(node.target, ast.Name)
            begin = node.target.end_col_offset or 0
        else:
            begin = end or 0
        text = f" = cython.declare({pure_type(kind)}{stated})"
        self._changes.append((node.lineno, begin, end or 0, text.encode()))

    def _weave_function(self, place: str, node: ast.FunctionDef, function: Declared) -> None:
        arguments = {one.arg: one for one in (*node.args.args, *node.args.kwonlyargs)}
        if [*arguments] != [*function.arguments]:
            raise self._error(place, f"takes other arguments than {[*function.arguments]}")
        self._decorate(node, function.decorators)
        for name, kind in function.arguments.items():
            annotation = arguments[name].annotation
            self._weave_type(f"{place}({name})", annotation, kind)
        if python_type(function.result):
            self._weave_result(place, node, function.result)
        inside = _assigners(ast.walk(node))
        self._all_there(place, function.local_types, inside)
        added = []
        for name, kind in function.local_types.items():
            one = inside[name]
            if isinstance(one, ast.AnnAssign):
                self._annotate(one.annotation, kind)
            else:
                added.append(f"{name}: {kind}")
        if added:
            has_text = ast.get_docstring(node) is not None
            first = node.body[1 if has_text else 0]
            indent = " " * first.col_offset
            self._inserted.setdefault(first.lineno, []).extend(indent + one for one in added)

    def _weave_result(self, place: str, node: ast.FunctionDef, result: str) -> None:
        if node.returns is None:
            raise self._error(place, f"has no result {result}")
        wanted = {python_type(result)} | ({"None", "bool"} if result == "int" else set())
        if ast.unparse(node.returns) not in wanted:
            raise self._error(place, f"gives no {' or '.join(sorted(wanted))}")
        self._annotate(node.returns, pure_type(result))
        for one in ast.walk(node):
            if isinstance(one, ast.Return) and one.value is None and one.end_col_offset:
                self._changes.append((one.lineno, one.end_col_offset, one.end_col_offset, b" 0"))

    def _weave_type(self, place: str, annotation: ast.expr | None, kind: str) -> None:
        wanted = python_type(kind)
        if wanted:
            if annotation is None or ast.unparse(annotation) != wanted:
                raise self._error(place, f"is no {wanted}")
            self._annotate(annotation, pure_type(kind))

    def _annotate(self, node: ast.expr, kind: str) -> None:
        assert node.lineno == node.end_lineno
        assert node.end_col_offset is not None
        self._changes.append((node.lineno, node.col_offset, node.end_col_offset, kind.encode()))

    def _decorate(self, node: ast.FunctionDef | ast.ClassDef, decorators: Sequence[str]) -> None:
        first = min(one.lineno for one in (node, *node.decorator_list))
        indent = " " * node.col_offset
        self._inserted.setdefault(first, []).extend(f"{indent}@{one}" for one in decorators)


def _module(node: ast.stmt) -> str:
    return (node.module or "") if isinstance(node, ast.ImportFrom) else ""


def _assigned(node: ast.AST) -> Iterator[str]:
    """The names that a statement assigns."""
    targets: list[ast.expr] = []
    if isinstance(node, ast.Assign):
        targets = node.targets
    elif isinstance(node, ast.AnnAssign | ast.For | ast.AugAssign | ast.NamedExpr):
        targets = [node.target]
    for target in targets:
        for part in ast.walk(target):
            if isinstance(part, ast.Name) and isinstance(part.ctx, ast.Store):
                yield part.id


def _assigners(nodes: Iterable[ast.AST]) -> dict[str, ast.AST]:
    """By each assigned name the statement that has its type, else the first that assigns it."""
    found: dict[str, ast.AST] = {}
    for node in nodes:
        for name in _assigned(node):
            if name not in found or isinstance(node, ast.AnnAssign):
                found[name] = node
    return found


def typed(source: str, declared: str, name: str) -> Typed:
    """A kernel with its types of C, as the compiler reads it.

    Args:
        source: the text of the `.py`.
        declared: the text of the `.pxd`; empty if there is none.
        name: what errors call the kernel.

    Raises:
        ValueError: the `.pxd` names what the `.py` has not, or has as another type.
    """
    if not declared:
        return Typed(source, [*range(1, source.count("\n") + 2)])
    return _Weaver(source, name).weave(ast.parse(source), declarations(declared))
