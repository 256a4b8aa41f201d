"""The kernels hold nothing that Cython compiles otherwise, with the directives of setup.py.

Each rule yields what it cannot prove to be alike in both forms; kernel_sources.toml says why that
is. A test of a name anywhere in a function counts as a guard: the rules find what was overlooked.
`initializedcheck` has its test in tests/robot/test_memory.py, `always_allow_keywords` in
tests/test_layout.py.
"""

from __future__ import annotations

import ast
import re
import tomllib
from collections.abc import Callable, Iterator
from functools import cache, cached_property
from pathlib import Path

import pytest

from swarmd.core.kernels import UNITS
from tests.support.kernel_forms import typed_text

ROOT = Path(__file__).resolve().parents[2]

pytestmark = pytest.mark.compiled_only(reason="reads the sources of both forms")

REASONS = tomllib.loads(Path(__file__).with_name("kernel_sources.toml").read_text())
"""By unit: what a rule yields, and why it is alike in both forms."""


DIRECTIVES = {
    *("wraparound", "cdivision", "boundscheck", "initializedcheck", "always_allow_keywords"),
    "nonecheck",  # True, as in Python
    *("language_level", "binding", "auto_pickle", "emit_code_comments"),  # of which none needs one
}
"""The directives that the rules know."""


@cache
def kernels() -> dict[str, Kernel]:
    """The kernels of each unit as one source, by the name of the unit without its package."""
    return {
        unit.rpartition("._")[2]: Kernel("".join(map(typed_text, names)))
        for unit, names in UNITS.items()
    }


class Function:
    """A function of a kernel, in its class if it has one."""

    def __init__(self, node: ast.FunctionDef, owner: ast.ClassDef | None) -> None:
        self.node, self.nodes = node, list(ast.walk(node))
        self.decorators = [ast.unparse(decorator) for decorator in node.decorator_list]
        self.types = {
            argument.arg: ast.unparse(argument.annotation)
            for argument in (*node.args.args, *node.args.kwonlyargs)
            if argument.annotation is not None
        }
        for prefix, fields in (("self.", owner.body if owner else []), ("", self.nodes)):
            for field in fields:
                if isinstance(field, ast.AnnAssign):
                    self.types[prefix + ast.unparse(field.target)] = ast.unparse(field.annotation)

    def type_of(self, node: ast.AST) -> str:
        """The declared type of a variable, an attribute, or an element of it; else empty."""
        if isinstance(node, ast.Subscript):
            return self.type_of(node.value).partition("[")[0]
        return self.types.get(ast.unparse(node), "")

    @cached_property
    def tests(self) -> str:
        """All that the function asks."""
        found: list[ast.expr] = []
        for node in self.nodes:
            if isinstance(node, ast.If | ast.IfExp | ast.While | ast.Assert):
                found.append(node.test)
            elif isinstance(node, ast.BoolOp):
                found += node.values
        return "\n".join(map(ast.unparse, found))

    def asks(self, text: str) -> bool:
        """True if a test of the function mentions this."""
        return bool(re.search(rf"(?<![\w.]){re.escape(text)}(?![\w(])", self.tests))

    @cached_property
    def starts(self) -> dict[str, str]:
        """Where each loop variable of a range starts."""
        return {
            ast.unparse(node.target): ast.unparse(node.iter.args[0]) if node.iter.args[1:] else "0"
            for node in self.nodes
            if isinstance(node, ast.For)
            and isinstance(node.iter, ast.Call)
            and ast.unparse(node.iter.func) == "range"
        }

    def binary(self, *kinds: type[ast.operator]) -> Iterator[tuple[ast.expr, ast.expr, ast.AST]]:
        """Both sides of each of these operations, and the operation."""
        for node in self.nodes:
            if isinstance(node, ast.BinOp) and isinstance(node.op, kinds):
                yield node.left, node.right, node
            elif isinstance(node, ast.AugAssign) and isinstance(node.op, kinds):
                yield node.target, node.value, node

    def assigned(self) -> Iterator[tuple[ast.expr, ast.expr]]:
        """Each target with its value, as far as they stand side by side."""
        for node in self.nodes:
            if isinstance(node, ast.AnnAssign) and node.value is not None:
                yield node.target, node.value
            for target in node.targets if isinstance(node, ast.Assign) else ():
                assert isinstance(node, ast.Assign)
                if isinstance(target, ast.Tuple) and isinstance(node.value, ast.Tuple):
                    yield from zip(target.elts, node.value.elts, strict=True)
                else:
                    yield target, node.value


class Kernel:
    """The source of a kernel."""

    def __init__(self, source: str) -> None:
        self.tree = ast.parse(source)
        top = self.tree.body
        self.classes = {node.name: node for node in top if isinstance(node, ast.ClassDef)}
        owners = [(node, owner) for owner in self.classes.values() for node in owner.body]
        self.functions = [
            Function(node, owner)
            for node, owner in (*((node, None) for node in top), *owners)
            if isinstance(node, ast.FunctionDef)
        ]
        self.constants = {
            ast.unparse(name)
            for node in top
            if isinstance(node, ast.Assign)
            for target in node.targets
            for name in (target.elts if isinstance(target, ast.Tuple) else [target])
        }

    def is_constant(self, node: ast.expr) -> bool:
        """True for numbers and names of the module; none of them is 0."""
        for part in ast.walk(node):
            if isinstance(part, ast.Call | ast.Attribute | ast.Subscript):
                return False
            if isinstance(part, ast.Name) and part.id not in self.constants:
                return False
            if isinstance(part, ast.Constant) and not part.value:
                return False
        return True


def ends_of(index: ast.expr) -> Iterator[ast.expr]:
    """The places of an index, and the ends of its slices."""
    for part in index.elts if isinstance(index, ast.Tuple) else [index]:
        ends = [part.lower, part.upper, part.step] if isinstance(part, ast.Slice) else [part]
        yield from (end for end in ends if end is not None)


def negative_indices(kernel: Kernel) -> Iterator[str]:
    """`wraparound` False: an error, or what lies before an array."""
    for node in ast.walk(kernel.tree):
        if isinstance(node, ast.Subscript):
            for end in ends_of(node.slice):
                if isinstance(end, ast.UnaryOp) and isinstance(end.op, ast.USub):
                    yield ast.unparse(node)


def differences_as_indices(kernel: Kernel) -> Iterator[str]:
    """A loop may start at 1, and a test may ask for the first number."""
    for function in kernel.functions:
        for node in function.nodes:
            for end in ends_of(node.slice) if isinstance(node, ast.Subscript) else ():
                for part in ast.walk(end):
                    if isinstance(part, ast.BinOp) and isinstance(part.op, ast.Sub):
                        first = ast.unparse(part.left)
                        start = function.starts.get(first, "0")
                        length = re.sub(r"^len\((.*)\)$", r"\1", first)
                        is_asked = function.asks(first) or function.asks(length)
                        if not is_asked and not re.search(r"^[1-9]|\+ 1$", start):
                            yield ast.unparse(node)


def divisors_that_may_be_zero(kernel: Kernel) -> Iterator[str]:
    """`cdivision` True: inf or NaN, and of whole numbers the end of the process."""
    for function in kernel.functions:
        for _, divisor, _ in function.binary(ast.Div, ast.FloorDiv, ast.Mod):
            text = ast.unparse(divisor).removeprefix("-")
            is_raised = (
                isinstance(divisor, ast.Call)
                and ast.unparse(divisor.func) in ("max", "_maximum")
                and kernel.is_constant(divisor.args[-1])
            )
            if not (is_raised or kernel.is_constant(divisor) or function.asks(text)):
                yield f"/ {text}"


def remainders_of_what_may_be_negative(kernel: Kernel) -> Iterator[str]:
    """`cdivision` True: `%` and `//` round towards zero."""

    def is_natural(function: Function, node: ast.expr, divisor: str) -> bool:
        if isinstance(node, ast.BinOp) and isinstance(node.op, ast.Add):
            sides = node.left, node.right
            is_raised = ast.unparse(node.right) == divisor
            return is_raised or all(is_natural(function, side, divisor) for side in sides)
        if isinstance(node, ast.Name):
            return node.id in function.starts or function.asks(node.id)
        return isinstance(node, ast.Attribute | ast.Constant)

    for function in kernel.functions:
        for left, right, node in function.binary(ast.FloorDiv, ast.Mod):
            if not is_natural(function, left, ast.unparse(right)):
                yield ast.unparse(node)


def powers(kernel: Kernel) -> Iterator[str]:
    """Python raises where C gives inf or NaN."""
    for function in kernel.functions:
        for base, exponent, node in function.binary(ast.Pow):
            if not (kernel.is_constant(base) and kernel.is_constant(exponent)):
                yield ast.unparse(node)


def casts(kernel: Kernel) -> Iterator[str]:
    """C casts NaN and numbers beyond the type to any number; Python raises."""
    for node in ast.walk(kernel.tree):
        if isinstance(node, ast.Call) and ast.unparse(node.func) == "cython.cast":
            yield f"cast {ast.unparse(node.args[1])}"


def narrow_numbers(kernel: Kernel) -> Iterator[str]:
    """What is kept with fewer bits than a number of Python."""
    for owner in kernel.classes.values():
        for node in owner.body:
            if isinstance(node, ast.AnnAssign):
                text = ast.unparse(node)
                is_flag = text.removeprefix("_").startswith("is_")
                if re.search(r"cython\.(int|short|uchar|float)\b", text) and not is_flag:
                    yield text


def whole_numbers_in_doubles(kernel: Kernel) -> Iterator[str]:
    """Python keeps them whole, and writes them so."""

    def is_whole(node: ast.expr) -> bool:
        if isinstance(node, ast.IfExp):
            return is_whole(node.body) or is_whole(node.orelse)
        if isinstance(node, ast.Call):
            name = ast.unparse(node.func)
            is_least = name in ("min", "max") and any(map(is_whole, node.args))
            return is_least or name in ("len", "round", "int")
        return isinstance(node, ast.Constant) and type(node.value) is int

    for function in kernel.functions:
        values = [(function.type_of(target), value) for target, value in function.assigned()]
        result = function.node.returns
        returned = [node.value for node in function.nodes if isinstance(node, ast.Return)]
        values += [
            ("" if result is None else ast.unparse(result), value) for value in returned if value
        ]
        arguments, defaults = function.node.args.args, function.node.args.defaults
        for argument, value in zip(reversed(arguments), reversed(defaults), strict=False):
            values.append((function.type_of(ast.Name(argument.arg)), value))
        yield from (ast.unparse(value) for kind, value in values
                    if kind == "cython.double" and is_whole(value))  # fmt: skip


MATHEMATICS = {"fabs", "sqrt", "cos", "sin", "atan2", "fmod", "floor", "max", "min", "copysign"}


def functions_that_hide_errors(kernel: Kernel) -> Iterator[str]:
    """`exceptval(check=False)`: an error is printed, and the result is 0."""
    hiding = [f for f in kernel.functions if "cython.exceptval(check=False)" in f.decorators]
    harmless = MATHEMATICS | {function.node.name for function in hiding}
    for function in hiding:
        for node in (node for line in function.node.body for node in ast.walk(line)):
            is_call = isinstance(node, ast.Call) and ast.unparse(node.func) not in harmless
            if is_call or isinstance(node, ast.Subscript | ast.Raise):
                yield f"{function.node.name}: {ast.unparse(node)}"


def results_that_mean_errors(kernel: Kernel) -> Iterator[str]:
    """`exceptval(-1)`: a result of -1 is taken for an error."""
    marked = [f for f in kernel.functions if "cython.exceptval(-1)" in f.decorators]
    names = {function.node.name for function in marked}
    for function in marked:
        for node in function.nodes:
            value = node.value if isinstance(node, ast.Return) else None
            is_call = isinstance(value, ast.Call) and ast.unparse(value.func)[5:] in names
            is_truth = isinstance(value, ast.Compare | ast.Constant | ast.UnaryOp)
            if value is not None and not (is_call or is_truth):
                yield f"{function.node.name}: {ast.unparse(value)}"


def unchecked_bounds(kernel: Kernel) -> Iterator[str]:
    """Beyond an array lies other memory."""
    for function in kernel.functions:
        if "cython.boundscheck(False)" in function.decorators:
            yield function.node.name


def objects_that_may_be_none(kernel: Kernel) -> Iterator[str]:
    """`nonecheck` is False: a part of None is other memory."""
    for owner in kernel.classes.values():
        kinds = {ast.unparse(node.target) for node in owner.body if isinstance(node, ast.AnnAssign)
                 and ast.unparse(node.annotation).split(" |")[0] in kernel.classes}  # fmt: skip
        functions = [f for f in kernel.functions if f.node in owner.body]
        pairs = [
            [(ast.unparse(target), ast.unparse(value)) for target, value in function.assigned()]
            for function in functions
        ]
        every = [pair for found in pairs for pair in found]
        unset = {target for target, value in every if re.search(r"\bNone\b", value)}
        unset |= {target for target, value in every if value in unset}
        unset = {name for name in unset if name.removeprefix("self.") in kinds}
        for function, found in zip(functions, pairs, strict=True):
            for name in unset | {target for target, value in found if value in unset}:
                is_used = re.search(rf"(?<![\w.]){name}\.\w", ast.unparse(function.node))
                if is_used and not re.search(rf"(?<![\w.]){name} is (not )?None", function.tests):
                    yield f"{function.node.name}: {name}"


def arrays_as_a_whole(kernel: Kernel) -> Iterator[str]:
    """C copies an array, and Python names it a second time."""
    for function in kernel.functions:
        for target, _ in function.assigned():
            is_element = isinstance(target, ast.Subscript)
            if not is_element and re.fullmatch(r"cython\.\w+\[\d+\]", function.type_of(target)):
                yield ast.unparse(target)


def words_that_compile_otherwise(kernel: Kernel) -> Iterator[str]:
    """Errors that C does not raise, and functions that see no variables of C."""
    for node in ast.walk(kernel.tree):
        if isinstance(node, ast.ExceptHandler):
            text = "BaseException" if node.type is None else ast.unparse(node.type)
            if re.search(r"ZeroDivision|Arithmetic|Overflow|Index|Lookup|\b(Base)?Exception", text):
                yield f"except {text}"
        name = ast.unparse(node.func) if isinstance(node, ast.Call) else ""
        if name in ("locals", "vars", "eval", "exec"):
            yield name


RULES: dict[Callable[[Kernel], Iterator[str]], tuple[str, ...]] = {
    negative_indices: ("sorted(x)[-2]", "x[:-n]", "x[0, -1]"),
    differences_as_indices: ("def f(x, k): return x[k - 1]", "def f(x): return x[len(x) - 1]"),
    divisors_that_may_be_zero: ("def f(a, b): return a / b", "def f(a): a %= b"),
    remainders_of_what_may_be_negative: (
        "def f(a, b): return (a - b) % n",
        "def f(a): return a // 2",
    ),
    powers: ("def f(a): return a ** 2",),
    casts: ("k = cython.cast(cython.int, a)",),
    narrow_numbers: ("class A:\n  k: cython.int", "class A:\n  k: cython.float[::1]"),
    whole_numbers_in_doubles: (
        "def f(a: cython.double = 0): pass",
        "class A:\n  a: cython.double\n  def f(self): self.a = 0",
        "def f(a) -> cython.double: return max(a, 0)",
        "class A:\n  a: cython.double[3]\n  def f(self): self.a[0] = 1",
    ),
    functions_that_hide_errors: ("@cython.exceptval(check=False)\ndef f(x): return x[0]",),
    results_that_mean_errors: ("@cython.exceptval(-1)\ndef f(x): return x",),
    unchecked_bounds: ("@cython.boundscheck(False)\ndef f(): pass",),
    objects_that_may_be_none: (
        "class A:\n  b: A\n  def f(self): self.b = None\n  def g(self):\n    b = self.b\n    b.b",
    ),
    arrays_as_a_whole: ("class A:\n  a: cython.int[3]\n  def f(self, b): self.a = b",),
    words_that_compile_otherwise: ("try: f()\nexcept (KeyError, IndexError): pass", "locals()"),
}


@pytest.mark.parametrize("rule", RULES, ids=lambda rule: rule.__name__)
def test_each_rule_finds_what_it_is_for(rule: Callable[[Kernel], Iterator[str]]) -> None:
    assert [bool([*rule(Kernel(source))]) for source in RULES[rule]] == [True] * len(RULES[rule])


def test_the_rules_know_each_directive() -> None:
    table = next(
        ast.literal_eval(node.value)
        for node in ast.parse((ROOT / "setup.py").read_text()).body
        if isinstance(node, ast.Assign) and ast.unparse(node.targets[0]) == "DIRECTIVES"
    )
    assert table.keys() == DIRECTIVES


def test_what_may_differ_between_the_forms_has_a_reason() -> None:
    places = {
        name: {text for rule in RULES for text in rule(kernel)}
        for name, kernel in kernels().items()
    }
    reasons = {name: {*REASONS.get(name, ())} for name in places}
    unknown = {name: texts - reasons[name] for name, texts in places.items()}
    assert {name: texts for name, texts in unknown.items() if texts} == {}
    past = {name: reasons[name] - texts for name, texts in places.items()}
    assert {name: texts for name, texts in past.items() if texts} == {}
