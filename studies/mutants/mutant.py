"""Mutants of a module: its source with one operator, number or condition changed.

cosmic-ray makes them. The operators are the usual ones of mutation testing: the neighbour of a
comparison, the counterpart of an arithmetic operator, a negated condition, another constant, an
ended or endless loop. A mutant of a type, of a decorator or of what only Cython reads changes
nothing that CPython runs, and is left out.
"""

from __future__ import annotations

import ast
import hashlib
from collections import Counter
from collections.abc import Iterator, Sequence

from msgspec import Struct

from swarmd.core.errors import SwarmError

SEED = 1
"""Of the draw."""
_MOVED = "swarmd/robot/protection/", "swarmd/protection/"
"""A place, and the one before, by which is drawn: a move changes no draw."""
OPERATORS: Sequence[str] = (
    *(
        f"ReplaceComparisonOperator_{pair}"
        for pair in ("Lt_LtE", "LtE_Lt", "Gt_GtE", "GtE_Gt", "Eq_NotEq", "NotEq_Eq")
    ),
    *(f"ReplaceComparisonOperator_{pair}" for pair in ("Lt_GtE", "LtE_Gt", "Gt_LtE", "GtE_Lt")),
    *(f"ReplaceComparisonOperator_{pair}" for pair in ("Is_IsNot", "IsNot_Is")),
    *(
        f"ReplaceBinaryOperator_{pair}"
        for pair in ("Add_Sub", "Sub_Add", "Mul_Div", "Div_Mul", "Mod_Mul", "FloorDiv_Mul")
    ),
    *(f"ReplaceBinaryOperator_{pair}" for pair in ("Pow_Mul", "BitOr_BitAnd", "BitAnd_BitOr")),
    *("ReplaceUnaryOperator_Delete_USub", "ReplaceUnaryOperator_Delete_Not", "AddNot"),
    *("ReplaceTrueWithFalse", "ReplaceFalseWithTrue", "ReplaceAndWithOr", "ReplaceOrWithAnd"),
    *("ReplaceBreakWithContinue", "ReplaceContinueWithBreak", "ZeroIterationForLoop"),
    *("NumberReplacer", "ExceptionReplacer"),
)
"""The operators of cosmic-ray that are used, by its own names."""


class Mutant(Struct, frozen=True, kw_only=True):
    """One change of one module."""

    path: str
    inside: str
    """The qualified name of the function or class; empty at the top of the module."""
    was: str
    """The changed lines."""
    now: str
    number: int = 1
    """Among mutants with the same text, in their order."""

    @property
    def name(self) -> str:
        """What tells it apart from others, also after a change of other lines."""
        place = f"{self.path} {self.inside}".strip()
        return f"{place}: {self.was} -> {self.now}" + (f" #{self.number}" * (self.number > 1))


def mutants_of(path: str, source: str, one_of: int = 1) -> Iterator[tuple[Mutant, str]]:
    """The drawn mutants of a module, each with its source; SwarmError without cosmic-ray.

    `one_of`: one in so many is drawn, by the text of its lines, so that a change of other lines
    changes no draw.
    """
    try:
        from cosmic_ray.ast import ast_nodes, get_ast
        from cosmic_ray.mutating import mutate_code
        from cosmic_ray.operators.provider import OperatorProvider
    except ImportError as error:
        raise SwarmError(
            "mutants need cosmic-ray: .venv/bin/python -m pip install 'cosmic-ray>=8.7,<9'"
        ) from error
    lines = source.splitlines(keepends=True)
    ignored = _places_that_never_run(source)
    names = _names_by_line(source)
    places: Counter[str] = Counter()
    seen: Counter[tuple[str, str, str]] = Counter()
    provider = OperatorProvider()
    for first, last, head in _parts(source):
        text = head + "".join(lines[first - 1 : last])
        offset = first - 1 - head.count("\n")
        nodes = [*ast_nodes(get_ast(text))]
        for name in OPERATORS:
            operator = provider[name]()
            starts = [start for node in nodes for start, _ in operator.mutation_positions(node)]
            for occurrence, (row, column) in enumerate(starts):
                line = row + offset
                if (line, column) in ignored:
                    continue
                inside = names.get(line, "")
                place = f"{path.replace(*_MOVED)} {inside} {name} {lines[line - 1].strip()}"
                places[place] += 1
                if not is_drawn(f"{place} {places[place]}", one_of):
                    continue
                mutated = mutate_code(text, operator, occurrence)
                if mutated is None or mutated == text or not _compiles(mutated):
                    continue
                was, now = _changed_lines(text, mutated)
                seen[inside, was, now] += 1
                number = seen[inside, was, now]
                mutant = Mutant(path=path, inside=inside, was=was, now=now, number=number)
                whole = [*lines[: first - 1], mutated.removeprefix(head), *lines[last:]]
                yield mutant, "".join(whole)


def _parts(source: str) -> Iterator[tuple[int, int, str]]:
    """The first and last line of each statement of a module and its classes, with a head.

    The head makes a module of the statement alone, which is mutated faster than the whole.
    """
    for node in ast.parse(source).body:
        inner = node.body if isinstance(node, ast.ClassDef) else [node]
        head = "class _:\n" if isinstance(node, ast.ClassDef) else ""
        for one in inner:
            decorators = getattr(one, "decorator_list", [])
            first = min([one.lineno, *(decorator.lineno for decorator in decorators)])
            yield first, one.end_lineno or first, head


def is_drawn(place: str, one_of: int) -> bool:
    """Whether a place in a source is in the draw of one in so many."""
    digest = hashlib.sha256(f"{SEED} {place}".encode()).digest()
    return int.from_bytes(digest[:8], "big") % one_of == 0


def _compiles(source: str) -> bool:
    try:
        compile(source, "mutant", "exec")
    except (SyntaxError, ValueError):
        return False
    return True


def _changed_lines(source: str, mutated: str) -> tuple[str, str]:
    """The lines that differ, without what both begin and end with."""
    old = source.splitlines()
    new = mutated.splitlines()
    first = next(k for k, (a, b) in enumerate(zip(old, new, strict=False)) if a != b)
    last = 0
    while last < min(len(old), len(new)) - first - 1 and old[-1 - last] == new[-1 - last]:
        last += 1
    return _joined(old[first : len(old) - last]), _joined(new[first : len(new) - last])


def _joined(lines: Sequence[str]) -> str:
    return " ".join(" ".join(lines).split())


def _names_by_line(source: str) -> dict[int, str]:
    """The qualified name of the innermost function or class of each line."""
    found: dict[int, str] = {}

    def enter(node: ast.AST, outer: str) -> None:
        for child in ast.iter_child_nodes(node):
            name = outer
            if isinstance(child, ast.FunctionDef | ast.AsyncFunctionDef | ast.ClassDef):
                name = f"{outer}.{child.name}".lstrip(".")
                end = child.end_lineno or child.lineno
                found.update((line, name) for line in range(child.lineno, end + 1))
            enter(child, name)

    enter(ast.parse(source), "")
    return found


class _Ignored(set[tuple[int, int]]):
    """Places (line, column) of parts of a source."""

    def cover(self, node: ast.AST, lines: Sequence[str]) -> None:
        """Add all places of a node."""
        first: int = node.lineno  # type: ignore[attr-defined]
        last: int = node.end_lineno  # type: ignore[attr-defined]
        for line in range(first, last + 1):
            begin: int = node.col_offset if line == first else 0  # type: ignore[attr-defined]
            end: int = len(lines[line - 1])
            if line == last:
                end = node.end_col_offset  # type: ignore[attr-defined]
            self.update((line, column) for column in range(begin, end + 1))

    def cover_head(
        self, node: ast.FunctionDef | ast.AsyncFunctionDef, lines: Sequence[str]
    ) -> None:
        """Add the head of a function, without the values of its defaults."""
        defaults = _Ignored()
        for default in (*node.args.defaults, *node.args.kw_defaults):
            if default is not None:
                defaults.cover(default, lines)
        for line in range(node.lineno, node.body[0].lineno):
            places = {(line, column) for column in range(len(lines[line - 1]) + 1)}
            self.update(places - defaults)


def _places_that_never_run(source: str) -> _Ignored:
    """The places that CPython does not run: types, decorators, and what Cython alone takes.

    Of the head of a function only the values of its defaults run.
    """
    lines = source.splitlines()
    ignored = _Ignored()
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef):
            ignored.cover_head(node, lines)
        for part in _parts_that_never_run(node):
            ignored.cover(part, lines)
    return ignored


def _parts_that_never_run(node: ast.AST) -> Sequence[ast.AST]:
    if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef | ast.ClassDef):
        return node.decorator_list
    if isinstance(node, ast.AnnAssign):
        return [node.annotation]
    if isinstance(node, ast.Assign) and _is_alias_of_type(node):
        return [node]
    if isinstance(node, ast.If):
        test = ast.unparse(node.test)
        if test.endswith(("TYPE_CHECKING", "compiled")):
            return [node.test] if test.startswith("not ") else [node.test, *node.body]
    return []


def _is_alias_of_type(node: ast.Assign) -> bool:
    """Whether a statement names a union of types, as `Start = Run | Resume`."""
    name = node.targets[0]
    is_union = isinstance(node.value, ast.BinOp) and isinstance(node.value.op, ast.BitOr)
    return is_union and isinstance(name, ast.Name) and name.id[:1].isupper()
