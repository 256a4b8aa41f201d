"""The compiled kernels; pyproject.toml holds everything else.

Each kernel is a Python file that Cython compiles (pure-Python mode): `barrier.py` becomes the
library `_barrier.abi3.so`. A kernel with PARTS has several sources, which are joined to one file
before Cython compiles them: a call between two libraries costs more than the arithmetic of most
functions. Where there is no compiler the build goes on without libraries, and CPython runs the
files. The stable ABI of Python 3.11 makes one wheel serve all later versions. Each library holds
the digest of its sources, which swarmd/core/kernels.py compares before it loads the library.
Cython's code for views of memory is in one library that all kernels import: a copy in each took a
quarter of the time of the build.

With SWARMD_COMPILED=0 nothing is compiled and Cython is not needed: `make demo` installs so first,
and compiles the kernels while robots move.
"""

import ast
import hashlib
import os
import sys
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

KERNELS = {
    "swarmd.kit.points": "swarmd/kit/points.py",
    "swarmd.protection.arbiter": "swarmd/protection/arbiter.py",
    "swarmd.protection.assumption_monitor": "swarmd/protection/assumption_monitor.py",
    "swarmd.protection.barrier": "swarmd/protection/barrier.py",
    "swarmd.protection.blind_zone": "swarmd/protection/blind_zone.py",
    "swarmd.protection.following": "swarmd/protection/following.py",
    "swarmd.protection.openings": "swarmd/protection/openings.py",
    "swarmd.protection.tracks": "swarmd/protection/tracks.py",
    "swarmd.protection.velocity_obstacles": "swarmd/protection/velocity_obstacles.py",
    "swarmd.robot.tick": "swarmd/robot/tick.py",
    "swarmd.sensing.scans": "swarmd/sensing/scans.py",
    "swarmd.sim.world.base": "sim/world/base.py",
    "swarmd.sim.world.ray_caster": "sim/world/ray_caster.py",
}
PARTS: dict[str, tuple[str, ...]] = {
    "swarmd/protection/barrier.py": (
        "swarmd/protection/buffers.py",
        "swarmd/protection/closing_speed.py",
        "swarmd/protection/barrier_assumptions.py",
        "swarmd/protection/outline.py",
        "swarmd/protection/dead_reckoning.py",
        "swarmd/protection/obstacles.py",
        "swarmd/protection/touch_zone.py",
        "swarmd/protection/constraints.py",
        "swarmd/protection/envelope.py",
        "swarmd/protection/projection.py",
        "swarmd/protection/stopping.py",
        "swarmd/protection/limiting_obstacles.py",
        "swarmd/protection/passage.py",
        "swarmd/protection/feasible_set.py",
    ),
}
"""By kernel, the files beside it that are joined in front of it, in this order.

A part imports from the parts before it. No two sources of a library define the same name.
"""
VIEWS = "swarmd.core._views"  # the library of VIEWS in swarmd/core/kernels.py
GENERATED, JOINED = Path("build/cython"), Path("build/joined")
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
]


def sources_of(kernel: str) -> list[Path]:
    """The sources of a kernel's library in their order, the kernel's own file last."""
    return [Path(path) for path in (*PARTS.get(kernel, ()), kernel)]


def join_sources(kernel: str) -> str:
    """The path of the file that Cython compiles; of a kernel with parts, all sources in one.

    Imports of one source from another are left out, as what they name is in the same file.
    """
    if kernel not in PARTS:
        return kernel
    sources = sources_of(kernel)
    modules = {".".join(source.with_suffix("").parts) for source in sources}
    joined = "from __future__ import annotations\n"
    for source in sources:
        lines = source.read_text().splitlines()
        for node in ast.parse("\n".join(lines)).body:
            is_docstring = node.lineno == 1
            if is_docstring or getattr(node, "module", "") in {"__future__", *modules}:
                lines[node.lineno - 1 : node.end_lineno] = [""] * (
                    node.end_lineno - node.lineno + 1
                )
        joined += "\n".join([*lines, ""])
    file = JOINED / kernel
    if not file.exists() or file.read_text() != joined:
        file.parent.mkdir(parents=True, exist_ok=True)
        file.write_text(joined)
    return str(file)


def write_digests(source: str) -> str:
    """The path of a C file with the digests of a library, written if they changed.

    The digests are of the kernel's sources, and of Cython's version and directives. A kernel that
    uses the views of another Cython might end the process.
    """
    import Cython

    file = (GENERATED / source).with_suffix(".digest.c")
    views = hashlib.sha256(f"{Cython.__version__} {DIRECTIVES}".encode()).hexdigest()
    text = f'const char views_digest[] = "{views}";\n'
    if source in KERNELS.values():
        sources = sources_of(source)
        digest = hashlib.sha256(b"".join(map(Path.read_bytes, sources))).hexdigest()
        text += f'const char source_digest[] = "{digest}";\n'
        text += f'const char source_names[] = "{" ".join(part.name for part in sources)}";\n'
    if not file.exists() or file.read_text() != text:
        file.parent.mkdir(parents=True, exist_ok=True)
        # Times of files do not tell: an older version of a source may be newer than its C code.
        for generated in (GENERATED / source, GENERATED / JOINED / source):
            generated.with_suffix(".c").unlink(missing_ok=True)
        file.write_text(text)
    return str(file)


def library(name: str) -> str:
    """The module name of a kernel's library."""
    package, _, file = name.rpartition(".")
    return f"{package}._{file}"


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

    sources = {library(name): path for name, path in KERNELS.items()}
    sources[VIEWS] = VIEWS.replace(".", "/") + ".c"
    digests = {name: write_digests(path) for name, path in sources.items()}
    sources = {name: join_sources(path) for name, path in sources.items()}
    modules = cythonize(
        [
            Extension(
                name,
                [path],
                extra_compile_args=FLAGS,
                define_macros=[("Py_LIMITED_API", STABLE_ABI)],
                py_limited_api=True,
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
    options={"bdist_wheel": {"py_limited_api": "cp311"}, "build_ext": {"parallel": True}},
)
