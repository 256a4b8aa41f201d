"""Signatures and docstrings of modules, classes and functions as Markdown.

The source files are parsed, and no module is imported.
"""

from __future__ import annotations

import ast
import copy
import inspect
import re
import textwrap
from collections.abc import Iterator, Sequence
from functools import cache
from itertools import zip_longest
from pathlib import Path

_ROOT = Path(__file__).resolve().parents[2]
_WIDTH = 96  # characters of a line of a signature
_MARKUP = re.compile(r"([<*\[\]$]|(?<!\w)_|_(?!\w))")  # `_` within a word is none
_C_TYPES = {"cython.double": "float", "cython.bint": "bool", "cython.Py_ssize_t": "int"}
_Definition = ast.ClassDef | ast.FunctionDef | ast.AsyncFunctionDef


def module(name: str, members: Sequence[str] | None = None) -> Iterator[str]:
    """The sections of a module with its public members, or with `members` alone.

    A name that the module imports for its `__all__` is listed under the module that defines it.
    """
    tree = _tree(name)
    origins = _origins(tree)
    places: dict[str, list[str]] = {}
    for member in members or _listed(tree) or _public(tree):
        places.setdefault(origins.get(member, name), []).append(member)
    order = {origin: index for index, origin in enumerate(dict.fromkeys(origins.values()))}
    for origin in sorted(places, key=lambda member: order.get(member, len(order))):
        shown = [part for member in places[origin] for part in _member(origin, member)]
        if shown:
            yield f"## {origin}"
            yield prose(ast.get_docstring(_tree(origin)) or "")
            yield from shown


def prose(text: str) -> str:
    """A docstring as Markdown: an indented block after `::` becomes code, other text is escaped."""
    parts = re.split(r"(?m)^(.*)::\n\n((?:[ ]{4}.*\n|\n)+)", inspect.cleandoc(text) + "\n")
    shown = _escaped(parts[0])
    for head, code, rest in zip(parts[1::3], parts[2::3], parts[3::3], strict=True):
        lead = _escaped(f"{head}:") + "\n\n" if head else ""
        shown += (
            f"{lead}```{_language(code)}\n{textwrap.dedent(code).strip()}\n```\n\n{_escaped(rest)}"
        )
    return shown.strip()


def _language(code: str) -> str:
    """`python`, or `text` for a block that does not parse."""
    try:
        ast.parse(textwrap.dedent(code))
    except SyntaxError:
        return "text"
    return "python"


def _escaped(text: str) -> str:
    parts = re.split(r"(`[^`]*`)", text)
    return "".join(part if part.startswith("`") else _MARKUP.sub(r"\\\1", part) for part in parts)


@cache
def _tree(name: str) -> ast.Module:
    path = _ROOT / "swarmd" / "/".join(name.split(".")[1:])
    file = path.with_suffix(".py") if path.with_suffix(".py").exists() else path / "__init__.py"
    return ast.parse(file.read_text())


def _listed(tree: ast.Module) -> list[str]:
    """The names in `__all__`."""
    for node in tree.body:
        if isinstance(node, ast.Assign) and ast.unparse(node.targets[0]) == "__all__":
            return list(ast.literal_eval(node.value))
    return []


def _public(tree: ast.Module) -> list[str]:
    return [
        node.name
        for node in tree.body
        if isinstance(node, _Definition) and not node.name.startswith("_")
    ]


def _origins(tree: ast.Module) -> dict[str, str]:
    """The module from which each imported name comes."""
    nodes = [node for node in tree.body if isinstance(node, ast.ImportFrom)]
    return {alias.name: node.module or "" for node in nodes for alias in node.names}


def _member(origin: str, name: str) -> Iterator[str]:
    """A class, function or value of the project; nothing for a value without a docstring."""
    body = _tree(origin).body if origin.startswith("swarmd.") else []
    for node, after in zip_longest(body, body[1:]):
        if isinstance(node, _Definition) and node.name == name:
            yield from _defined(node, name, "###")
            return
        if name == _target(node) and _text(after):
            yield f"### {name}"
            yield _code(ast.unparse(node))
            yield prose(_text(after))
            return


def _defined(node: _Definition, name: str, level: str) -> Iterator[str]:
    yield f"{level} {name}"
    yield _code(_class(node) if isinstance(node, ast.ClassDef) else _function(node))
    yield prose(ast.get_docstring(node) or "")
    if not isinstance(node, ast.ClassDef):
        return
    fields = [
        f"- `{_target(field)}`: {' '.join(prose(text).split())}"
        for field, after in zip_longest(node.body, node.body[1:])
        if (text := _text(after)) and _target(field)
    ]
    if fields:
        yield "\n".join(fields)
    for member in node.body:
        is_function = isinstance(member, ast.FunctionDef | ast.AsyncFunctionDef)
        if is_function and not member.name.startswith("_") and ast.get_docstring(member):
            yield from _defined(member, f"{name}.{member.name}", f"{level}#")


def _class(node: ast.ClassDef) -> str:
    """The head of a class with its public fields and its constructor.

    The fields of a class of pattern parameters (`Params`) are left out.
    """
    bases = ", ".join(map(ast.unparse, [*node.bases, *node.keywords]))
    lines = [*_decorators(node), f"class {node.name}{f'({bases})' if bases else ''}:"]
    is_params = any(ast.unparse(base).endswith("Params") for base in node.bases)
    for member in node.body:
        if (
            isinstance(member, ast.AnnAssign)
            and not is_params
            and not _target(member).startswith("_")
        ):
            lines += textwrap.indent(ast.unparse(member), "    ").splitlines()
        elif isinstance(member, ast.FunctionDef) and member.name == "__init__":
            lines += textwrap.indent(_function(member), "    ").splitlines()
    return "\n".join(lines).removesuffix(":") if lines[-1].endswith(":") else "\n".join(lines)


def _function(node: ast.FunctionDef | ast.AsyncFunctionDef) -> str:
    """The decorators and the signature; a long signature has a line for each parameter.

    A function of a kernel shows the types that a caller in Python passes.
    """
    node = _PlainTypes().visit(copy.deepcopy(node))
    word = "async def" if isinstance(node, ast.AsyncFunctionDef) else "def"
    returned = f" -> {ast.unparse(node.returns)}" if node.returns else ""
    line = f"{word} {node.name}({ast.unparse(node.args)}){returned}"
    if len(line) > _WIDTH:
        parts = "".join(f"    {parameter},\n" for parameter in _parameters(ast.unparse(node.args)))
        line = f"{word} {node.name}(\n{parts}){returned}"
    return "\n".join([*_decorators(node), line])


def _parameters(text: str) -> Iterator[str]:
    """The parameters of a signature, split at commas outside of brackets and strings."""
    depth, begin, quote = 0, 0, ""
    for index, sign in enumerate(text):
        if quote:
            quote = "" if sign == quote else quote
        elif sign in "'\"":
            quote = sign
        elif sign in "([{":
            depth += 1
        elif sign in ")]}":
            depth -= 1
        elif sign == "," and not depth:
            yield text[begin:index].strip()
            begin = index + 1
    yield text[begin:].strip()


class _PlainTypes(ast.NodeTransformer):
    """Puts the Python type in place of each C type that Cython names."""

    def visit_Attribute(self, node: ast.Attribute) -> ast.expr:
        if ast.unparse(node) in _C_TYPES:
            return ast.Name(_C_TYPES[ast.unparse(node)])
        return node


def _decorators(node: _Definition) -> list[str]:
    texts = map(ast.unparse, node.decorator_list)
    return [f"@{text}" for text in texts if not text.startswith("cython.")]


def _target(node: ast.stmt) -> str:
    """The name that a statement assigns; else empty."""
    if isinstance(node, ast.Assign):
        return ast.unparse(node.targets[0])
    return ast.unparse(node.target) if isinstance(node, ast.AnnAssign) else ""


def _text(node: ast.stmt | None) -> str:
    """The string of a bare string statement, such as the docstring of a field; else empty."""
    is_text = isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant)
    return str(node.value.value) if is_text else ""


def _code(text: str) -> str:
    return f"```python\n{text}\n```"
