"""Assignments that pack several statements into one.

Packed is `a, b = x, y`, unless a later value reads a name that an earlier place sets, as in a swap
or a shift (`a, b = b, a + b`), and `a = b = 0.0` of a plain value. Not packed is one value that is
unpacked (`a, b = pair`), or that gets two names (`new = self._open = Link()`).
"""

from __future__ import annotations

import ast
from collections.abc import Iterator

from tests.support.shape import statements


def packed_assignments(tree: ast.Module) -> Iterator[ast.Assign]:
    """The packed assignments of a file."""
    for node in statements(tree):
        if isinstance(node, ast.Assign) and (_is_chain(node) or _is_packed(node)):
            yield node


def _is_chain(node: ast.Assign) -> bool:
    """True for one plain value that several places get."""
    if len(node.targets) < 2:
        return False
    value = node.value.operand if isinstance(node.value, ast.UnaryOp) else node.value
    is_dotted = isinstance(value, ast.Attribute) and isinstance(value.value, ast.Name)
    return is_dotted or isinstance(value, ast.Constant | ast.Name)


def _is_packed(node: ast.Assign) -> bool:
    """True for places that get values of a tuple, none of which reads a place before its own."""
    target = node.targets[0]
    if len(node.targets) > 1 or not isinstance(target, ast.Tuple):
        return False
    if not isinstance(node.value, ast.Tuple) or len(target.elts) != len(node.value.elts):
        return False
    parts = [*target.elts, *node.value.elts]
    if any(isinstance(part, ast.Starred) for part in parts):
        return False
    earlier: set[str] = set()
    for place, value in zip(target.elts, node.value.elts, strict=True):
        read = {ast.unparse(part) for part in ast.walk(value) if isinstance(part, ast.expr)}
        read |= {ast.unparse(part) for part in ast.walk(place) if part is not place}
        if earlier & read:
            return False
        earlier.add(ast.unparse(place))
    return True
