"""The compiled kernels; pyproject.toml holds everything else.

Each kernel is a Python file that Cython compiles (pure-Python mode). swarmd/core/kernels.py lists
the libraries, the units in each, and the kernels in each unit. A `.pxd` beside a kernel has its
types of C, which swarmd/core/kernel_types.py puts into a copy of it. A unit is one C file: its
kernels are joined, without the imports of each other. A library is linked of its units. Where there
is no compiler the build goes on without libraries, and CPython runs the files. A library serves the
Python that builds it, and is faster than one for the stable ABI (.92 of the time in the median of
four seeds; single pairs at load gave .79 to 1.35). With SWARMD_STABLE_ABI=1 it serves Python 3.11
and later versions, as in the wheels for all. Each library holds the digest of its sources, which
swarmd/core/kernels.py compares before it loads the library. Cython's code for views of memory is in
one library that all kernels import: a copy in each took a quarter of the time of the build.

With SWARMD_COMPILED=0 nothing is compiled and Cython is not needed: `make demo` installs so first,
and compiles the kernels while robots move.
"""

import ast
import hashlib
import os
import re
import runpy
import sys
from collections.abc import Iterable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import chdir
from functools import cache
from pathlib import Path
from typing import Any

from setuptools import Extension, setup
from setuptools.command.build import build
from setuptools.command.build_ext import build_ext
from setuptools.errors import CompileError

# pip of Ubuntu 22.04 builds with the system's setuptools, which ignores pyproject.toml: it would
# install a package UNKNOWN without any code.
if sys.version_info < (3, 11):  # noqa: UP036
    sys.exit(
        "swarmd needs Python 3.11 or newer, and this is"
        f" {sys.version_info.major}.{sys.version_info.minor}; install the archive, which brings its"
        " own: docs/installation.md"
    )

KERNELS = runpy.run_path("swarmd/core/kernels.py")
LIBRARIES, UNITS, HELPERS = KERNELS["LIBRARIES"], KERNELS["UNITS"], KERNELS["HELPERS"]
VIEWS = KERNELS["VIEWS"]
source_of, digest_of, kernels_of, files_of = (
    KERNELS[name] for name in ("source_of", "digest_of", "kernels_of", "files_of")
)
TYPES = runpy.run_path("swarmd/core/kernel_types.py")
GENERATED = Path("build/cython")
JOINED = Path("build/joined")
SHADOW = "swarmd.core.cython_shadow"
LINES_ARE_NAMED = "/* with the lines of the sources */\n"
IS_STABLE = os.environ.get("SWARMD_STABLE_ABI") == "1"
MACROS = [("Py_LIMITED_API", "0x030B0000")] if IS_STABLE else []
DIRECTIVES = {
    "language_level": "3",
    "boundscheck": True,  # costs 4 to 9 % and stays: one of them decides what the base may do
    "wraparound": False,
    "initializedcheck": False,
    # An attribute of None is an error: a robot is also made of the memory in a recording of others.
    "nonecheck": True,
    "cdivision": True,
    # Calls of methods are a third faster so.
    "binding": False,
    "always_allow_keywords": False,
    # The memory of a robot is in recordings (robot/memory.py). Other classes opt out: the code is a
    # quarter of a library.
    "auto_pickle": True,
    "emit_code_comments": False,
}
# Without contraction the results are those of the interpreted file, operation by operation. No
# operation of the kernels reads errno or traps, so loops can be vectorised.
FLAGS = [
    "-O3",
    "-funroll-loops",  # a tenth of a decision beside eight robots; a tenth more code
    "-ffp-contract=off",
    "-fno-math-errno",
    "-fno-trapping-math",
    "-fno-thread-jumps",
    "-g0",  # a third of the compiler's time
    "-Wno-unused-const-variable",  # docstrings, of Cython
    "-Wno-unused-function",  # of a kernel in several libraries: each uses a part
]


def write(file: Path, text: str) -> bool:
    """Write a file if its text changes; true if it did."""
    if file.exists() and file.read_text() == text:
        return False
    file.parent.mkdir(parents=True, exist_ok=True)
    file.write_text(text)
    return True


@cache
def typed(kernel: str) -> Any:
    """A kernel with its types of C (`Typed` of swarmd/core/kernel_types.py)."""
    source, declared = (Path(file) for file in files_of(kernel))
    text = declared.read_text() if declared.exists() else ""
    return TYPES["typed"](source.read_text(), text, str(source))


def contents(kernels: Iterable[str]) -> list[bytes]:
    """What is in the files of these kernels."""
    files = (Path(file) for kernel in kernels for file in files_of(kernel))
    return [file.read_bytes() for file in files if file.exists()]


def write_unit(unit: str) -> None:
    """Write the source of a unit into its folder in JOINED.

    The source includes a copy of each kernel, in the place that Cython's tracebacks shall name.
    NAMES has, by kernel, the names that `import` of the kernel gives: all but those of C functions,
    and constants of C as numbers of Python.
    """
    kernels = UNITS[unit]
    trees = {kernel: ast.parse(typed(kernel).text) for kernel in kernels}
    meanings: dict[str, set[str]] = {}
    for kernel, tree in trees.items():
        for name, meaning in names_of(tree, kernel):
            meanings.setdefault(name, set()).add(meaning)
    ambiguous = {name for name, found in meanings.items() if len(found) > 1}
    if shared := sorted(name for name in ambiguous if not name.startswith("_")):
        raise ValueError(f"in {unit} several kernels define {', '.join(shared)}")
    functions = {
        f"{kernel}.{node.name}"
        for kernel, tree in trees.items()
        for node in tree.body
        if isinstance(node, ast.FunctionDef)
        and "cython.cfunc" in map(ast.unparse, node.decorator_list)
    }
    classes_in = {
        f"{kernel}.{node.name}"
        for kernel, tree in trees.items()
        for node in tree.body
        if isinstance(node, ast.ClassDef)
    }
    text = "from __future__ import annotations\n\nNAMES = {}\n"
    for number, (kernel, tree) in enumerate(trees.items()):
        own = {name: f"{name}_{number}" for name, _ in names_of(tree, kernel) if name in ambiguous}
        file = kernel.replace(".", "/") + ".py"
        write(JOINED / unit / file, copy_of(kernel, tree, kernels, own))
        given = {
            name
            for name, meaning in names_of(tree, kernel)
            if meaning not in functions and (not name.startswith("_") or meaning in classes_in)
        }
        names = ", ".join(f'"{name}": {own.get(name, name)}' for name in sorted(given))
        text += f'include "{file}"\n'
        if kernel not in HELPERS:
            text += f'NAMES["{kernel}"] = {{{names}}}\n'
        classes = [node for node in tree.body if isinstance(node, ast.ClassDef)]
        for node in classes:
            if "cython.cclass" not in map(ast.unparse, node.decorator_list):
                text += f'{own.get(node.name, node.name)}.__module__ = "{kernel}"\n'
    digest = digest_of(contents(kernels))
    title = unit.rpartition(".")[2]
    if write(JOINED / unit / f"{title}.pyx", f"# {digest} {views_digest()}\n{text}"):
        # Times of files do not tell: an older version of a source may be newer than its C code.
        (GENERATED / unit / f"{title}.c").unlink(missing_ok=True)


def copy_of(kernel: str, tree: ast.Module, kernels: tuple[str, ...], own: dict[str, str]) -> str:
    """The text of a kernel as a part of a unit; each statement keeps its line of the typed text.

    Without the imports of other kernels of the unit, with Cython in place of its stand-in, and with
    the names `own` in place of private names that another kernel has, too.
    """
    lines = typed(kernel).text.encode().splitlines(keepends=True)
    fields = {
        field.target
        for node in ast.walk(tree)
        if isinstance(node, ast.ClassDef)
        for field in node.body
        if isinstance(field, ast.AnnAssign)
    }
    renamed = [
        node
        for node in {*ast.walk(tree)} - fields
        if isinstance(node, ast.Name | ast.ClassDef | ast.FunctionDef)
        and getattr(node, "id", getattr(node, "name", "")) in own
    ]
    for node in sorted(renamed, key=lambda node: (node.lineno, -node.col_offset)):
        name = node.id if isinstance(node, ast.Name) else node.name
        line = lines[node.lineno - 1]
        start = line.index(name.encode(), node.col_offset)
        lines[node.lineno - 1] = line[:start] + own[name].encode() + line[start + len(name) :]
    left = {node.id for node in ast.walk(ast.parse(b"".join(lines))) if isinstance(node, ast.Name)}
    if unclear := sorted(left & own.keys()):  # a field, or a name in an f-string
        raise ValueError(
            f"{kernel} must name {', '.join(unclear)} otherwise, as another kernel does"
        )
    for node in tree.body:
        if not isinstance(node, ast.ImportFrom):
            continue
        first = node.lineno - 1
        if node.module in (*kernels, "__future__"):
            lines[first : node.end_lineno] = [b"\n"] * (node.end_lineno - first)
        elif node.module == SHADOW:
            named = [one.name for one in node.names if one.name not in TYPES["VIEWS"].values()]
            text = f"from cython.cimports.libc.math import {', '.join(named)}\n" if named else "\n"
            lines[first : node.end_lineno] = [
                text.encode(),
                *[b"\n"] * ((node.end_lineno or node.lineno) - node.lineno),
            ]
        elif node.module == SHADOW.rpartition(".")[0] and node.names[0].name == "cython_shadow":
            lines[first] = b"import cython\n"
    return b"".join(lines).decode()


def names_of(tree: ast.Module, kernel: str) -> Iterator[tuple[str, str]]:
    """The names that a kernel has at its top, and where each is defined."""
    for node in tree.body:
        if isinstance(node, ast.ClassDef | ast.FunctionDef):
            yield node.name, f"{kernel}.{node.name}"
        elif isinstance(node, ast.ImportFrom):
            if node.module not in ("__future__", SHADOW):
                for alias in node.names:
                    if alias.name != "cython_shadow":
                        yield alias.asname or alias.name, f"{node.module}.{alias.name}"
        elif isinstance(node, ast.Assign | ast.AnnAssign):
            targets = node.targets if isinstance(node, ast.Assign) else [node.target]
            for part in (part for target in targets for part in ast.walk(target)):
                if isinstance(part, ast.Name):
                    yield part.id, f"{kernel}.{part.id}"


def name_modules(unit: str, file: Path) -> None:
    """Let the C code name the kernel of each class and function, where Cython names the unit.

    A kernel that several units contain keeps the unit: its classes exist once for each.
    """
    owners = {}
    for kernel in UNITS[unit]:
        if sum(kernel in others for others in UNITS.values()) == 1:
            for node in ast.parse(typed(kernel).text).body:
                if isinstance(node, ast.ClassDef | ast.FunctionDef):
                    owners[node.name] = kernel

    def named(match: re.Match[str]) -> str:
        return f'"{owners.get(match[2], unit)}.{match[1]}{match[2]}'

    pattern = rf'"{re.escape(unit)}\.((?:"")?)(\w+)'
    text = re.sub(pattern, named, file.read_text())
    write(file, text)


def name_lines(unit: str, file: Path) -> None:
    """Let the C code name the lines of the sources, where Cython names those of the typed text."""
    text = file.read_text()
    if text.endswith(LINES_ARE_NAMED):
        return
    table = re.search(r"__pyx_f\[\] = \{(.*?)\};", text, re.DOTALL)
    assert table
    kernels = {kernel.replace(".", "/") + ".py": kernel for kernel in UNITS[unit]}
    names = re.findall(r'"(.*)"', table[1])

    def named(match: re.Match[str]) -> str:
        kernel = kernels.get(names[int(match[2])])
        line = match[3] if kernel is None else typed(kernel).lines[int(match[3]) - 1]
        return f"{match[1]}({match[2]}, {line}, "

    text = re.sub(r"\b(__PYX_ERR|__PYX_MARK_ERR_POS)\((\d+), (\d+), ", named, text)
    write(file, text + LINES_ARE_NAMED)


def views_digest() -> str:
    """The digest of Cython's version and directives.

    A kernel that uses the views of another Cython might end the process.
    """
    import Cython

    return hashlib.sha256(f"{Cython.__version__} {DIRECTIVES}".encode()).hexdigest()


def write_digests(library: str) -> str:
    """The path of a C file with the digests of a library, written if they changed."""
    file = GENERATED / f"{library}.digest.c"
    text = f'const char views_digest[] = "{views_digest()}";\n'
    if library in LIBRARIES:
        digest = digest_of(contents(kernels_of(library)))
        text += f'const char source_digest[] = "{digest}";\n'
    write(file, text)
    return str(file)


class BuildKernels(build_ext):
    """Builds the libraries; an editable installation uses the folders of `build_ext --inplace`.

    So the installation compiles nothing a second time. By default, setuptools builds an editable
    installation in an empty folder.
    """

    def finalize_options(self) -> None:
        """Take the folders of a build in place."""
        if self.editable_mode:
            usual = build(self.distribution)
            usual.ensure_finalized()
            self.build_lib, self.build_temp = usual.build_platlib, usual.build_temp
        super().finalize_options()

    def build_extensions(self) -> None:
        """Compile the units that have changed, all at the same time, and link the libraries."""
        sources = sorted(
            {source for one in self.extensions for source in one.sources},
            key=lambda source: -Path(source).stat().st_size,  # the longest first
        )
        with ThreadPoolExecutor(os.cpu_count()) as pool:
            objects = dict(zip(sources, pool.map(self._object_of, sources), strict=True))
        for one in self.extensions:
            made = [objects[source] for source in one.sources]
            if all(made):  # else setuptools tries again, and says what is wrong
                one.extra_objects, one.depends, one.sources = made, made, []
        super().build_extensions()

    def _object_of(self, source: str) -> str | None:
        """The object file of a C file; None if it does not compile."""
        folder = str(Path(self.build_temp) / ("stable" if IS_STABLE else "full"))
        (made,) = self.compiler.object_filenames([source], output_dir=folder)
        if Path(made).exists() and Path(made).stat().st_mtime > Path(source).stat().st_mtime:
            return made
        try:
            self.compiler.compile(
                [source],
                output_dir=folder,
                macros=MACROS,
                include_dirs=self.include_dirs,
                extra_postargs=FLAGS,
            )
        except CompileError:
            return None
        return made


def code_of_same_text(unit: str) -> str:
    """The path of the C code of a unit in the build folder $SWARMD_MADE_IN of another copy.

    Empty unless Cython made it of the very text that is here: to run Cython on all units takes 20 s
    of the trial of a wheel, whose kernels `make kernels` has compiled before.
    """
    made = Path(os.environ.get("SWARMD_MADE_IN", ""))
    code = made / GENERATED.name / unit / f"{unit.rpartition('.')[2]}.c"
    if "SWARMD_MADE_IN" not in os.environ or not code.exists():
        return ""
    texts = [file for file in (JOINED / unit).rglob("*") if file.suffix in (".py", ".pyx")]
    for text in texts:
        other = made / text.relative_to(JOINED.parent)
        if not other.exists() or text.read_bytes() != other.read_bytes():
            return ""
    own = GENERATED / unit / code.name
    write(own, code.read_text())
    return str(own)


def write_code(module: str) -> str:
    """Write the C code of a unit, or of the views; its path."""
    from Cython.Build import cythonize

    title = module.rpartition(".")[2]
    generated = (GENERATED / module).absolute()
    if module in UNITS:
        write_unit(module)
        if taken := code_of_same_text(module):
            return taken
    folder = JOINED / module
    folder.mkdir(parents=True, exist_ok=True)
    with chdir(folder):  # so that tracebacks name the files by their places in the package
        cythonize(
            [Extension(module, [f"{title}.pyx" if module in UNITS else f"{title}.c"])],
            compiler_directives=DIRECTIVES,
            shared_utility_qualified_name=VIEWS,
            build_dir=str(generated),
            quiet=True,
        )
    code = GENERATED / module / f"{title}.c"
    if module in UNITS:
        name_modules(module, code)
        name_lines(module, code)
    return str(code)


def kernels() -> list[Extension]:
    """The libraries to build; their C code is written."""
    return [
        Extension(
            library,
            [*map(write_code, LIBRARIES.get(library, (library,))), write_digests(library)],
            extra_compile_args=FLAGS,
            define_macros=MACROS,
            py_limited_api=IS_STABLE,
            optional=True,
        )
        for library in (*LIBRARIES, VIEWS)
    ]


setup(
    cmdclass={"build_ext": BuildKernels},
    ext_modules=[] if os.environ.get("SWARMD_COMPILED") == "0" else kernels(),
    options={"bdist_wheel": {"py_limited_api": "cp311" if IS_STABLE else False}},
)
