"""The compiled kernels; pyproject.toml holds everything else.

Each kernel is a Python file that Cython compiles (pure-Python mode): `barrier.py` becomes the
library `_barrier`. Several files may become one library: they are joined first, without the imports
of each other. Where there is no compiler the build goes on without libraries, and CPython runs the
files. A library serves the Python that builds it, and takes .92 of the time of one for the stable
ABI. With SWARMD_STABLE_ABI=1, as for wheels, it serves Python 3.11 and all later versions. Each
library holds the digest of its sources, which swarmd/core/kernels.py compares before it loads the
library; that file lists the libraries. Cython's code for views of memory is in one library that all
kernels import: a copy in each took a quarter of the time of the build.

With SWARMD_COMPILED=0 nothing is compiled and Cython is not needed: `make demo` installs so first,
and compiles the kernels while robots move.
"""

import ast
import hashlib
import os
import runpy
import sys
from collections.abc import Iterator
from pathlib import Path

from setuptools import Extension, setup
from setuptools.command.build import build
from setuptools.command.build_ext import build_ext

# pip of Ubuntu 22.04 builds with the system's setuptools, which ignores pyproject.toml: it would
# install a package UNKNOWN without any code.
if sys.version_info < (3, 11):  # noqa: UP036
    sys.exit(
        "swarmd needs Python 3.11 or newer, and this is"
        f" {sys.version_info.major}.{sys.version_info.minor}; install the archive, which brings its"
        " own: docs/installation.md"
    )

KERNELS = runpy.run_path("swarmd/core/kernels.py")
LIBRARIES, VIEWS = KERNELS["LIBRARIES"], KERNELS["VIEWS"]
source_of, digest_of = KERNELS["source_of"], KERNELS["digest_of"]
GENERATED = Path("build/cython")
JOINED = Path("build/joined")
IS_STABLE = os.environ.get("SWARMD_STABLE_ABI") == "1"
STABLE_ABI = "0x030B0000"
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


def joined(library: str) -> str:
    """The path of one source with all kernels of a library.

    The lines that import from each other are empty. A name at the top of the files has one meaning.
    CLASSES tells the kernel of each class, or the library if its kernel is in several.
    """
    kernels = LIBRARIES[library]
    if len(kernels) == 1:
        return source_of(*kernels)
    text, classes = "from __future__ import annotations\n", {}
    meanings: dict[str, str] = {}
    for kernel in kernels:
        content = Path(source_of(kernel)).read_text()
        lines = content.splitlines(keepends=True)
        for node in ast.parse(content).body:
            for name, meaning in meanings_of(node, kernel):
                if meanings.setdefault(name, meaning) != meaning:
                    raise ValueError(f"{name} of {kernel} means {meanings[name]} in {library}")
            if isinstance(node, ast.ClassDef):
                is_shared = sum(kernel in others for others in LIBRARIES.values()) > 1
                classes[node.name] = library if is_shared else kernel
            if isinstance(node, ast.ImportFrom) and node.module in (*kernels, "__future__"):
                first = node.lineno - 1
                lines[first : node.end_lineno] = ["\n"] * (node.end_lineno - first)
        text += "".join(lines)
    file = JOINED / f"{library.replace('.', '/')}.py"
    write(file, f"{text}\nCLASSES = {classes}\n")
    return str(file)


def meanings_of(node: ast.stmt, kernel: str) -> Iterator[tuple[str, str]]:
    """The names that a statement at the top of a kernel sets, and where each is defined."""
    if isinstance(node, ast.ClassDef | ast.FunctionDef):
        yield node.name, f"{kernel}.{node.name}"
    elif isinstance(node, ast.ImportFrom):
        for alias in node.names:
            yield alias.asname or alias.name, f"{node.module}.{alias.name}"
    elif isinstance(node, ast.Assign | ast.AnnAssign):
        for part in ast.walk(node):
            if isinstance(part, ast.Name) and isinstance(part.ctx, ast.Store):
                yield part.id, f"{kernel}.{part.id}"


def write_digests(library: str, source: str) -> str:
    """The path of a C file with the digests of a library, written if they changed.

    The digests are of the kernels' sources, and of Cython's version and directives. A kernel that
    uses the views of another Cython might end the process.
    """
    import Cython

    file = (GENERATED / source).with_suffix(".digest.c")
    views = hashlib.sha256(f"{Cython.__version__} {DIRECTIVES}".encode()).hexdigest()
    text = f'const char views_digest[] = "{views}";\n'
    if library in LIBRARIES:
        digest = digest_of([Path(source_of(name)).read_bytes() for name in LIBRARIES[library]])
        text += f'const char source_digest[] = "{digest}";\n'
    if write(file, text):
        # Times of files do not tell: an older version of a source may be newer than its C code.
        (GENERATED / source).with_suffix(".c").unlink(missing_ok=True)
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


def kernels() -> list[Extension]:
    """The libraries to build; their C code is written."""
    from Cython.Build import cythonize

    sources = {library: joined(library) for library in LIBRARIES}
    sources[VIEWS] = VIEWS.replace(".", "/") + ".c"
    digests = {name: write_digests(name, path) for name, path in sources.items()}
    modules = cythonize(
        [
            Extension(
                name,
                [path],
                extra_compile_args=FLAGS,
                define_macros=[("Py_LIMITED_API", STABLE_ABI)] if IS_STABLE else [],
                py_limited_api=IS_STABLE,
            )
            for name, path in sources.items()
        ],
        compiler_directives=DIRECTIVES,
        shared_utility_qualified_name=VIEWS,
        build_dir=str(GENERATED),
        quiet=True,
    )
    for module in modules:
        module.sources.append(digests[module.name])
        module.optional = True  # cythonize drops it from the extensions that it is given
    return list(modules)


setup(
    cmdclass={"build_ext": BuildKernels},
    ext_modules=[] if os.environ.get("SWARMD_COMPILED") == "0" else kernels(),
    options={
        "bdist_wheel": {"py_limited_api": "cp311" if IS_STABLE else False},
        "build_ext": {"parallel": True},
    },
)
