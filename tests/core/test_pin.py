"""The pin: its environment, and how a process finds that it is pinned."""

from __future__ import annotations

import json
import math
import os
import platform
import subprocess
import sys
from collections.abc import Mapping
from contextlib import suppress
from pathlib import Path

import pytest

from swarmd.core import pin
from swarmd.core.pin import digest_of_functions, functions_here, is_pinned, pinned_environment

CODE = (
    "import json; from swarmd.core.pin import functions_here; print(json.dumps(functions_here()))"
)
NO_FMA = "-FMA,-FMA4,-AVX2,-FMA_Usable,-FMA4_Usable,-AVX2_Usable"
on_x86_64 = pytest.mark.skipif(
    platform.machine() != "x86_64" or platform.libc_ver()[0] != "glibc",
    reason="glibc on x86-64 alone has a pin",
)


@pytest.mark.parametrize(
    ("given", "wanted"),
    [
        ("", f"glibc.cpu.hwcaps={NO_FMA}"),
        ("glibc.malloc.check=3", f"glibc.malloc.check=3:glibc.cpu.hwcaps={NO_FMA}"),
        # glibc takes the last word `hwcaps`, and in it the last word on a capability.
        (
            "glibc.cpu.hwcaps=-ERMS,+FMA:glibc.malloc.check=3",
            f"glibc.malloc.check=3:glibc.cpu.hwcaps=-ERMS,{NO_FMA}",
        ),
        (f"glibc.cpu.hwcaps={NO_FMA}", f"glibc.cpu.hwcaps={NO_FMA}"),
    ],
)
def test_the_users_own_tunables_stay_but_for_those_of_the_pin(
    given: str, wanted: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(platform, "machine", lambda: "x86_64")
    made = pinned_environment({"GLIBC_TUNABLES": given, "HOME": "/h"})
    assert made["GLIBC_TUNABLES"] == wanted
    assert made["HOME"] == "/h"


def test_numpy_is_asked_for_its_baseline_by_the_names_that_it_has(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """numpy refuses NPY_ENABLE_CPU_FEATURES beside it, and names of its baseline."""
    from numpy._core._multiarray_umath import (  # type: ignore[import-not-found]  # numpy has no types for it
        __cpu_baseline__,
        __cpu_dispatch__,
    )

    monkeypatch.setattr(platform, "machine", lambda: "x86_64")
    made = pinned_environment({"NPY_ENABLE_CPU_FEATURES": "AVX2"})
    names = made["NPY_DISABLE_CPU_FEATURES"].split()
    assert sorted(names) == sorted(__cpu_dispatch__)
    assert not {*names} & {*__cpu_baseline__}
    assert "NPY_ENABLE_CPU_FEATURES" not in made
    assert made["OPENBLAS_CORETYPE"] == "Nehalem"


def test_another_machine_has_no_pin(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(platform, "machine", lambda: "aarch64")
    assert pinned_environment({"HOME": "/h"}) == {"HOME": "/h"}
    monkeypatch.setenv("OPENBLAS_CORETYPE", "Nehalem")
    assert not is_pinned()


def last_bit(x: float) -> float:
    return math.nextafter(math.exp(x), 9.0)


@pytest.mark.parametrize("broken", ["nothing", "libm", "numpy", "blas", "machine"])
def test_a_process_is_pinned_by_what_it_computes_and_not_by_its_environment(
    broken: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A process that is asked to be pinned, as all of its variables say, has one other part."""
    for name, text in pinned_environment({}).items():
        monkeypatch.setenv(name, text)
    monkeypatch.setattr(platform, "machine", lambda: "x86_64" if broken != "machine" else "arm64")
    monkeypatch.setattr(pin, "_simd", lambda: {"found": ["X86_V3"]} if broken == "numpy" else {})
    function = last_bit if broken == "libm" else math.exp
    monkeypatch.setattr(pin, "_WITHOUT_FMA", ((function, 0.25, math.exp(0.25).hex()),))
    monkeypatch.setenv("OPENBLAS_CORETYPE", "Haswell" if broken == "blas" else "Nehalem")
    assert is_pinned() == (broken == "nothing")
    assert functions_here()["pinned"] == ("yes" if broken == "nothing" else "no")


def test_a_function_with_another_last_bit_has_another_digest(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    here = digest_of_functions()
    assert digest_of_functions() == here
    atan2 = math.atan2
    monkeypatch.setattr(math, "atan2", lambda y, x: math.nextafter(atan2(y, x), 9.0))
    assert digest_of_functions() != here


def of_a_process(environment: Mapping[str, str]) -> dict[str, str]:
    """What a process computes with that starts with an environment; a warning is an error."""
    done = subprocess.run(
        [sys.executable, "-W", "error", "-c", CODE],
        env=environment,
        capture_output=True,
        text=True,
        check=True,
    )
    found: dict[str, str] = json.loads(done.stdout)
    return found


def _has_fma() -> bool:
    with suppress(OSError):
        return " fma " in Path("/proc/cpuinfo").read_text()
    return False


@on_x86_64
@pytest.mark.integration
def test_a_process_with_this_environment_is_pinned_and_with_a_part_of_it_it_is_not() -> None:
    whole = pinned_environment()
    pinned = of_a_process(whole)
    assert pinned["pinned"] == "yes"
    # Another choice of OpenBLAS' is undone, and nothing else of the environment counts.
    again = of_a_process(pinned_environment({**os.environ, "OPENBLAS_CORETYPE": "Haswell"}))
    assert again == pinned
    free = of_a_process({k: v for k, v in whole.items() if k != "GLIBC_TUNABLES"})
    assert free["pinned"] == ("no" if _has_fma() else "yes")
    assert (free["functions"] != pinned["functions"]) == _has_fma()
