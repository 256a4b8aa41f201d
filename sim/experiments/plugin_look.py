"""A look at the source of a plugin: whether its results follow from its files alone.

The store of runs takes a plugin only if its syntax trees show that it imports nothing outside its
folder and the packages of `made_with`, reads no file, no environment, no clock and no random
numbers but those that it is given. What the look does not understand counts as a fault: a plugin
that is refused is run each time. The look guards against accidents; it is no sandbox.
"""

from __future__ import annotations

import ast
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path

from swarmd.core.errors import PluginError
from swarmd.core.files import read_regular
from swarmd.plugins import METRICS_FILE, PATTERN_FILE, parsed

_STANDARD = frozenset(
    (
        *("__future__", "abc", "array", "base64", "bisect", "cmath", "collections", "contextlib"),
        *("copy", "dataclasses", "decimal", "enum", "fractions", "functools", "graphlib"),
        *("hashlib", "heapq", "itertools", "json", "math", "numbers", "operator", "re"),
        *("statistics", "string", "struct", "textwrap", "types", "typing", "warnings", "zlib"),
    )
)
"""Modules of the standard library that compute, and do nothing else."""
_OTHERS = (
    *("msgspec", "numpy"),
    *(f"scipy.{name}" for name in ("integrate", "interpolate", "linalg", "ndimage", "optimize")),
    *(f"scipy.{name}" for name in ("signal", "sparse", "spatial", "special")),
    *("swarmd.api", "swarmd.core.angles", "swarmd.core.errors", "swarmd.core.values"),
    *("swarmd.kit", "swarmd.patterns", "swarmd.robot.sensing", "swarmd.sim.metrics"),
    "swarmd.sim.trace.Trace",
)
"""Packages of `made_with`, of swarmd those that compute."""
_NAMES = frozenset(
    (
        *("__builtins__", "__cached__", "__file__", "__import__", "__loader__", "__path__"),
        *("__spec__", "breakpoint", "compile", "delattr", "eval", "exec", "globals", "hash"),
        *("help", "id", "input", "locals", "open", "setattr", "vars"),
    )
)
"""Built-in names that lead out of a module. `hash` of a text differs between processes."""
_ATTRIBUTES = frozenset(
    (
        *("__base__", "__bases__", "__builtins__", "__closure__", "__code__", "__dict__"),
        *("__file__", "__getattribute__", "__globals__", "__loader__", "__mro__", "__reduce__"),
        *("__reduce_ex__", "__spec__", "__subclasses__", "dump", "environ", "getenv"),
        *("read_bytes", "read_text", "tofile", "write_bytes", "write_text"),
    )
)
"""Attributes of any object that lead out of a module, or to a file."""
_IN_PACKAGES = frozenset(
    (
        *("DataSource", "Path", "ZipFile", "basinhopping", "builtins", "ctypeslib", "ctypes"),
        *("differential_evolution", "digest_of_file", "distutils", "dual_annealing", "f2py"),
        *("fromfile", "fromregex", "genfromtxt", "import_file", "importlib", "installed_metrics"),
        *("io", "lib", "load", "load_trace", "loadtxt", "memmap", "metric_of", "metric_of_file"),
        *("open", "os", "pathlib", "random", "save", "savetxt", "savez", "savez_compressed"),
        *("shgo", "shutil", "socket", "subprocess", "sys", "testing", "threading"),
        *("check_grad", "clarkson_woodruff_transform", "datetime64", "eigs", "eigsh"),
        *("expm_multiply", "interpolative", "lobpcg", "onenormest", "qmc_quad"),
        *("quadratic_assignment", "rand", "random_array", "svds", "NormalDist"),
    )
)
"""Names in packages that lead to files, to other modules, or to random numbers of their own."""
_METRICS = METRICS_FILE.removesuffix(".py")
_RANDOM = "numpy.random"
_OF_RANDOM = (f"{_RANDOM}.Generator", f"{_RANDOM}.BitGenerator")
_WITH_SEED = f"{_RANDOM}.default_rng"


@dataclass(frozen=True, slots=True)
class Look:
    """What the source of a plugin tells."""

    fault: str
    """Why its results may follow from more than its files; empty if they do not."""
    texts: frozenset[str]
    """All texts in it: a plugin may make another one by its name."""


def look_at(file: Path) -> Look:
    """The look at the plugin in a file, with the modules of its folder that it imports.

    The modules of a folder are a package if the file is a `pattern.py`, as in `import_file`.
    """
    package = file.parent if file.name == PATTERN_FILE else None
    waiting = [file]
    seen: set[Path] = set()
    texts: set[str] = set()
    while waiting:
        path = waiting.pop()
        if path in seen:
            continue
        seen.add(path)
        name = path.name if package is None else path.relative_to(package).as_posix()
        try:
            tree = parsed(read_regular(path), path)
            source = _Source(path, package)
            source.visit(tree)
        except OSError as error:
            return Look(f"{name} cannot be read: {error.strerror}", frozenset())
        except (PluginError, RecursionError):
            return Look(f"{name} cannot be parsed", frozenset())
        source.check_seeds()
        if source.faults:
            line, fault = min(source.faults)
            return Look(f"{name}:{line} {fault}", frozenset())
        texts |= source.texts
        waiting += source.modules
    return Look("", frozenset(texts))


@dataclass
class _Source(ast.NodeVisitor):
    """One source file."""

    file: Path
    package: Path | None
    """The folder whose modules it may import; None: it may import none."""
    faults: list[tuple[int, str]] = field(default_factory=list)
    """Lines with what is wrong there."""
    texts: set[str] = field(default_factory=set)
    modules: list[Path] = field(default_factory=list)
    """The files that it imports."""
    _imported: dict[str, str] = field(default_factory=dict)
    """What an imported name stands for, with dots."""
    _whole: set[str] = field(default_factory=set)
    """The names of imported modules."""
    _none: set[str] = field(default_factory=set)
    """Names that may stand for None, such as of a word whose default it is."""
    _seeds: list[tuple[ast.AST, set[str]]] = field(default_factory=list)
    """Calls of `default_rng`, with the names that are their seeds."""

    def visit_Import(self, node: ast.Import) -> None:
        for alias in node.names:
            self._check_import(node, alias.name)
            name = alias.asname or alias.name.partition(".")[0]
            self._imported[name] = alias.name if alias.asname else name
            self._whole.add(name)

    def visit_ImportFrom(self, node: ast.ImportFrom) -> None:
        if node.level:
            self._import_beside(node)
            return
        module = node.module or ""
        for alias in node.names:
            whole = f"{module}.{alias.name}"
            if alias.name == "*":
                self._fault(node, f"imports all names of {module}")
            self._check_import(node, module, whole)
            self._check_chain(node, whole)
            self._imported[alias.asname or alias.name] = whole

    def visit_Name(self, node: ast.Name) -> None:
        if node.id in _NAMES:
            self._fault(node, f"uses {node.id}")
        if node.id in self._whole:  # alone, so that what happens to the module is not seen
            self._fault(node, f"hands on the module {node.id}")
        if self._imported.get(node.id) == _WITH_SEED:  # other than as a call with a seed
            self._fault(node, f"uses {_WITH_SEED}")

    def visit_Attribute(self, node: ast.Attribute) -> None:
        if node.attr in _ATTRIBUTES:
            self._fault(node, f"uses {node.attr}")
        parts = _chain(node)
        whole = self._imported.get(parts[0]) if parts else None
        if whole is None:
            self.generic_visit(node)
            return
        self._check_chain(node, ".".join((whole, *parts[1:])))

    def visit_Call(self, node: ast.Call) -> None:
        parts = _chain(node.func)
        whole = self._imported.get(parts[0], "") if parts else ""
        called = ".".join((whole, *parts[1:]))
        if called == _WITH_SEED and self._has_seed(node):
            given = (*node.args, *(keyword.value for keyword in node.keywords))
            self._seeds.append((node, {name for one in given for name in _last_names(one)}))
            for inner in (*node.args, *node.keywords):
                self.visit(inner)
            return
        if parts == ("getattr",):
            name = node.args[1] if len(node.args) > 1 else None
            if not (isinstance(name, ast.Constant) and isinstance(name.value, str)):
                self._fault(node, "looks an attribute up by a name that is computed")
            elif name.value in _ATTRIBUTES | _IN_PACKAGES:
                self._fault(node, f"uses {name.value}")
        self.generic_visit(node)

    def visit_arguments(self, node: ast.arguments) -> None:
        named = [*node.posonlyargs, *node.args]
        with_default = zip(named[len(named) - len(node.defaults) :], node.defaults, strict=True)
        for word, value in (*with_default, *zip(node.kwonlyargs, node.kw_defaults, strict=True)):
            if _is_none(value):
                self._none.add(word.arg)
        self.generic_visit(node)

    def visit_Assign(self, node: ast.Assign) -> None:
        if _is_none(node.value):
            self._none.update(name for target in node.targets for name in _last_names(target))
        self.generic_visit(node)

    def visit_AnnAssign(self, node: ast.AnnAssign) -> None:
        if _is_none(node.value):
            self._none.update(_last_names(node.target))
        self.generic_visit(node)

    def check_seeds(self) -> None:
        """A fault for each generator whose seed may be None; called after the visit."""
        for node, names in self._seeds:
            if names & self._none:
                self._fault(node, f"uses {_WITH_SEED} with a seed that may be None")

    def visit_Constant(self, node: ast.Constant) -> None:
        if isinstance(node.value, str):
            self.texts.add(node.value)

    def _has_seed(self, node: ast.Call) -> bool:
        """Whether a call of `default_rng` has a seed that may be a value: without one it draws."""
        given = [*node.args, *(keyword.value for keyword in node.keywords)]
        return bool(given) and not any(_is_none(one) for one in given)

    def _check_import(self, node: ast.AST, *names: str) -> None:
        """A fault unless one of these dotted names lies in a package that computes.

        The metrics beside a pattern compute, too, but the digest of swarmd's code leaves them out.
        """
        for name in names:
            if name.startswith("swarmd.patterns.") and _METRICS in name.split("."):
                self._fault(node, f"imports {name}")
                return
        for name in names:
            if name.partition(".")[0] in _STANDARD:
                return
            if any(name == one or name.startswith(f"{one}.") for one in _OTHERS):
                return
        self._fault(node, f"imports {names[0]}")

    def _check_chain(self, node: ast.AST, whole: str) -> None:
        """A fault if a dotted name leads out of the packages that compute."""
        if whole in _OF_RANDOM:
            return
        bad = next((name for name in whole.split(".")[1:] if name in _IN_PACKAGES), None)
        is_of_import = isinstance(node, ast.ImportFrom) and whole == _WITH_SEED
        if bad is not None and not is_of_import:
            self._fault(node, f"uses {whole}")

    def _import_beside(self, node: ast.ImportFrom) -> None:
        """Follow `from .name import value` to the file in the folder of a `pattern.py`."""
        place = self.file.parent
        for _ in range(node.level - 1):
            place = place.parent
        if self.package is None or not place.is_relative_to(self.package):
            self._fault(node, "imports from outside its folder")
            return
        for name in (node.module or "").split("."):
            place = place / name if name else place
            self._follow(place)
        found = place.with_suffix(".py").is_file() if node.module else True
        for alias in node.names:
            found |= self._follow(place / alias.name)
            if alias.name == "*":
                self._fault(node, "imports all names of a module")
        if not found and not (place / "__init__.py").is_file():
            self._fault(node, f"imports {'.' * node.level}{node.module or ''}, which is no file")

    def _follow(self, place: Path) -> bool:
        """Add the file of a module, or of a package; False if there is none."""
        files = [place.with_suffix(".py"), place / "__init__.py"]
        there = [path for path in files if path.is_file()]
        self.modules += there
        return bool(there)

    def _fault(self, node: ast.AST, text: str) -> None:
        self.faults.append((getattr(node, "lineno", 1), text))


def _is_none(node: ast.AST | None) -> bool:
    return isinstance(node, ast.Constant) and node.value is None


def _last_names(node: ast.AST) -> Iterator[str]:
    """The name of a value: `seed` of `seed` and of `self.seed`; nothing of another form."""
    if isinstance(node, ast.Name):
        yield node.id
    elif isinstance(node, ast.Attribute):
        yield node.attr


def _chain(node: ast.AST) -> tuple[str, ...]:
    """The names of `a.b.c`; empty for an expression of another form."""
    return tuple(reversed([*_names(node)]))


def _names(node: ast.AST) -> Iterator[str]:
    names = []
    while isinstance(node, ast.Attribute):
        names.append(node.attr)
        node = node.value
    if isinstance(node, ast.Name):
        yield from (*names, node.id)
