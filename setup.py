"""The compiled kernels; pyproject.toml holds everything else.

Each kernel is a Python file that Cython compiles (pure-Python mode): `barrier.py` becomes the
library `_barrier.abi3.so`. Where there is no compiler the build goes on without libraries, and
CPython runs the files. The stable ABI of Python 3.11 makes one wheel serve all later versions. Each
library holds the digest of its source, which swarmd/core/kernels.py compares before it loads the
library.
"""

import hashlib
import sys
from pathlib import Path

from Cython.Build import cythonize
from setuptools import Extension, setup

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
    "swarmd.protection.assumption_monitor": "swarmd/protection/assumption_monitor.py",
    "swarmd.protection.barrier": "swarmd/protection/barrier.py",
    "swarmd.protection.blind_zone": "swarmd/protection/blind_zone.py",
    "swarmd.protection.following": "swarmd/protection/following.py",
    "swarmd.sensing.scans": "swarmd/sensing/scans.py",
    "swarmd.sim.world.base": "sim/world/base.py",
    "swarmd.sim.world.ray_caster": "sim/world/ray_caster.py",
}
GENERATED = Path("build/cython")
STABLE_ABI = "0x030B0000"
DIRECTIVES = {
    "language_level": "3",
    "boundscheck": True,  # costs 4 to 9 % and stays: one of them decides what the base may do
    "wraparound": False,
    "initializedcheck": False,
    "cdivision": True,
}


def write_digest(source: str) -> str:
    """The path of a C file with the digest of a kernel's source, written if it changed."""
    file = (GENERATED / source).with_suffix(".digest.c")
    text = (
        f'const char source_digest[] = "{hashlib.sha256(Path(source).read_bytes()).hexdigest()}";\n'
    )
    if not file.exists() or file.read_text() != text:
        file.parent.mkdir(parents=True, exist_ok=True)
        # Times of files do not tell: an older version of a source may be newer than its C code.
        (GENERATED / source).with_suffix(".c").unlink(missing_ok=True)
        file.write_text(text)
    return str(file)


def library(name: str) -> str:
    """The module name of a kernel's library."""
    package, _, file = name.rpartition(".")
    return f"{package}._{file}"


digests = {library(name): write_digest(path) for name, path in KERNELS.items()}
extensions = [
    Extension(
        library(name),
        [path],
        # Without contraction the results are those of the interpreted file, operation by operation.
        # No operation of the kernels reads errno or traps, so loops can be vectorised.
        extra_compile_args=[
            "-O3",
            "-ffp-contract=off",
            "-fno-math-errno",
            "-fno-trapping-math",
            "-fno-thread-jumps",
            "-g0",  # a third of the compiler's time
        ],
        define_macros=[("Py_LIMITED_API", STABLE_ABI)],
        py_limited_api=True,
    )
    for name, path in KERNELS.items()
]
modules = cythonize(
    extensions, compiler_directives=DIRECTIVES, build_dir=str(GENERATED), quiet=True
)
for module in modules:
    module.sources.append(digests[module.name])
    module.optional = True  # cythonize drops it from the extensions that it is given
setup(
    ext_modules=modules,
    options={"bdist_wheel": {"py_limited_api": "cp311"}, "build_ext": {"parallel": True}},
)
