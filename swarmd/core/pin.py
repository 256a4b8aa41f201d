"""The pin: the variants of mathematical functions that every x86-64 has.

glibc, numpy and OpenBLAS choose among variants of their functions as a process starts, by its
processor. The variants give other last bits. A *pinned* process has those of the oldest x86-64 that
numpy supports, so its results have equal bits on every x86-64 with the same libc, numpy and mujoco.
The variables act at the start of a process, and its forks inherit what it has chosen.

Other machines, such as arm64, have no pin: there `pinned_environment` changes nothing, and
`is_pinned` is false.
"""

from __future__ import annotations

import hashlib
import math
import os
import platform
import re
import sys
from collections.abc import Mapping
from contextlib import suppress
from pathlib import Path
from typing import cast

from swarmd.core.libm import digest_of_libm

_X86_64 = ("x86_64", "AMD64")
_TUNABLES = "GLIBC_TUNABLES"
_HWCAPS = "glibc.cpu.hwcaps"
_DISABLED = "NPY_DISABLE_CPU_FEATURES"
_ENABLED = "NPY_ENABLE_CPU_FEATURES"
_CORE_TYPE = "OPENBLAS_CORETYPE"
# Variants of libm need FMA and AVX2, or FMA4. Names with _Usable are those before glibc 2.33 (not
# tried); glibc ignores names that it does not know.
_NO_FMA = "-FMA,-FMA4,-AVX2,-FMA_Usable,-FMA4_Usable,-AVX2_Usable"
# The oldest processor of numpy 2.4 (X86_V2); OpenBLAS in wheels of numpy and scipy has it.
_OLDEST_CORE = "Nehalem"

_WITHOUT_FMA = (
    (math.exp, 0.5987, "0x1.d1db3d684e10ap+0"),
    (math.exp, 0.663, "0x1.f0cb846a0c170p+0"),
    (math.exp, 0.4592, "0x1.9532dad3c82e0p+0"),
    (math.log, 0.9107, "-0x1.7f25a0d0b7273p-4"),
    (math.log, 1.1546, "0x1.26687a6431dadp-3"),
)
"""Functions and arguments whose last bit differs with FMA, and the result without it.

glibc has the same code for both functions since 2.28, and so has musl (both from Arm's optimized
routines); measured with glibc 2.36. Another C library gives other bits: it does not count as
pinned."""
_POINTS = 600  # arguments of a function


def pinned_environment(environment: Mapping[str, str] | None = None) -> dict[str, str]:
    """The environment of a process that is to be pinned; None: made of that of this process.

    The own words of GLIBC_TUNABLES stay, but for those of the pin. On a machine without a pin the
    environment is unchanged.
    """
    pinned = dict(os.environ if environment is None else environment)
    if platform.machine() not in _X86_64:
        return pinned
    pinned[_TUNABLES] = _with_hwcaps(pinned.get(_TUNABLES, ""))
    # numpy refuses both variables together.
    pinned.pop(_ENABLED, None)
    pinned[_DISABLED] = " ".join(_dispatched())
    pinned[_CORE_TYPE] = _OLDEST_CORE
    return pinned


def _with_hwcaps(tunables: str) -> str:
    """The words of GLIBC_TUNABLES with those of the pin; glibc takes the last `hwcaps` alone."""
    words = [word for word in tunables.split(":") if word]
    own = [word for word in words if word.partition("=")[0] == _HWCAPS]
    caps = [cap for cap in own[-1].partition("=")[2].split(",") if cap] if own else []
    turned_off = _NO_FMA.split(",")
    # The last of two words on a capability would win: +FMA of the user goes.
    others = [cap for cap in caps if f"-{cap.lstrip('+-')}" not in turned_off]
    kept = [word for word in words if word not in own]
    return ":".join([*kept, f"{_HWCAPS}={','.join([*others, *turned_off])}"])


def _dispatched() -> list[str]:
    """The names of numpy's variants beyond its baseline (`__cpu_dispatch__`), here or not.

    numpy refuses a name of its baseline at import, and ignores one that this processor lacks.
    """
    found = _simd()
    return [*found.get("found", ()), *found.get("not found", ())]


def _simd() -> dict[str, list[str]]:
    import numpy as np  # swarmctl starts without it

    found = np.show_config(mode="dicts")["SIMD Extensions"]
    return cast("dict[str, list[str]]", found)


def is_pinned() -> bool:
    """Whether this process computes as every x86-64 does: what its functions give, not its names.

    False also where that is not known: for another C library, and on other machines.
    """
    if platform.machine() not in _X86_64 or os.environ.get(_CORE_TYPE) != _OLDEST_CORE:
        return False
    if any(function(x).hex() != result for function, x, result in _WITHOUT_FMA):
        return False
    return not _simd().get("found")


def how_made() -> dict[str, str]:
    """What a recording says of the process that made it, by name; cheap enough for a daemon.

    `pinned` (`yes`, `no`), `processor`, and what chooses or brings functions: `simd` (the
    instruction sets that numpy uses), `numpy` and `libc` with their versions.
    """
    import numpy as np  # after the environment is set: numpy reads it at its import

    simd = _simd()
    return {
        "pinned": "yes" if is_pinned() else "no",
        "processor": processor(),
        "simd": " ".join((*simd.get("baseline", ()), *simd.get("found", ()))),
        "numpy": np.__version__,
        "libc": _libc(),
    }


def _libc() -> str:
    """The C library with its version; `platform.libc_ver` takes 4 ms for it."""
    with suppress(ValueError, OSError):  # another C library than glibc
        return os.confstr("CS_GNU_LIBC_VERSION") or "unknown"
    return "unknown"


def functions_here() -> dict[str, str]:
    """What decides the bits of this process beside versions and code, by name.

    - `pinned`: `yes` if `is_pinned`, else `no`.
    - `processor`: its name; `machine`: the system and the kind of processor.
    - `libm`: `digest_of_libm`.
    - `functions`: a digest of elementary functions, sums and products of Python and numpy.
    - `simd`: the instruction sets that numpy uses.
    - `blas`: OPENBLAS_CORETYPE, which overrides OpenBLAS's own choice.
    """
    simd = _simd()
    return {
        "pinned": "yes" if is_pinned() else "no",
        "libm": digest_of_libm(),
        "functions": digest_of_functions(),
        "machine": f"{platform.system()} {platform.machine()}",
        "processor": processor(),
        "simd": " ".join((*simd.get("baseline", ()), *simd.get("found", ()))),
        "blas": os.environ.get(_CORE_TYPE) or "as the processor is",
    }


def processor(facts: Path = Path("/proc/cpuinfo")) -> str:
    """The name of the processor; unknown if the system does not tell."""
    with suppress(OSError):
        if found := re.search(r"^model name\s*: (.*)$", facts.read_text(), re.MULTILINE):
            return found[1]
    return "unknown"


def digest_of_functions() -> str:
    """8 hex digits of what functions, sums and products of libm and numpy give for fixed arguments.

    Wider than `digest_of_libm`, which recordings of robots have: numpy chooses by itself.
    """
    import numpy as np  # swarmctl starts without it

    x = np.linspace(-0.999, 0.999, _POINTS)
    positive = 3.0 + 2.5 * x
    square = x[:400].reshape(20, 20) + np.eye(20)
    of_libm = [
        [function(7.0 * value) for value in x.tolist()]
        for function in (math.sin, math.cos, math.tan, math.atan, math.exp, math.expm1, math.tanh)
    ]
    of_libm += [[math.asin(value) for value in x.tolist()]]
    of_libm += [
        [function(value) for value in positive.tolist()] for function in (math.log, math.log1p)
    ]
    of_libm += [[math.atan2(a, b) for a, b in zip(x.tolist(), positive.tolist(), strict=True)]]
    of_numpy = [
        *(
            function(7.0 * x)
            for function in (np.sin, np.cos, np.tan, np.arctan, np.exp, np.expm1, np.tanh)
        ),
        *(function(x) for function in (np.arcsin, np.arccos)),
        *(function(positive) for function in (np.log, np.log1p, np.sqrt)),
        np.arctan2(x, positive),
        np.hypot(x, positive),
        np.power(positive, x),
        np.array([x.sum(), x[:7].sum(), x @ positive]),
        square @ square,
        np.einsum("ij,kj->ik", square, square),
        np.linalg.solve(square, x[:20]),
        np.random.default_rng(1).normal(size=_POINTS),
    ]
    digest = hashlib.sha256()
    for values in (*map(np.array, of_libm), *of_numpy):
        digest.update(np.ascontiguousarray(values, dtype=np.float64).tobytes())
    return digest.hexdigest()[:8]


def restart_pinned() -> None:
    """Begin this Python program again as a pinned process, unless it is one or cannot be.

    The call does not return if the program begins again. A program that stays unpinned although
    its environment asks for it, goes on.
    """
    pinned = pinned_environment()
    names = [name for name in (_TUNABLES, _CORE_TYPE) if name in pinned]
    asked = all(os.environ.get(name) == pinned[name] for name in names)
    if asked or is_pinned():
        return
    sys.stdout.flush()
    sys.stderr.flush()
    os.execve(sys.executable, [sys.executable, *sys.orig_argv[1:]], pinned)
