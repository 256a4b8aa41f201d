"""The digest of the C library's functions tells its variants apart."""

from __future__ import annotations

import math
import os
import platform
import subprocess
import sys
from contextlib import suppress
from pathlib import Path

import pytest

from swarmd.core import libm
from swarmd.core.libm import digest_of_libm


def _has_two_variants() -> bool:
    """Whether glibc may choose here: it has variants for x86-64 processors with FMA."""
    with suppress(OSError):
        is_glibc = platform.libc_ver()[0] == "glibc"
        return is_glibc and " fma " in Path("/proc/cpuinfo").read_text()
    return False


@pytest.mark.integration
@pytest.mark.skipif(not _has_two_variants(), reason="the C library has no choice here")
def test_another_variant_of_the_mathematical_functions_is_reported() -> None:
    code = "from swarmd.core import libm; print(libm.digest_of_libm())"
    done = subprocess.run(
        [sys.executable, "-c", code],
        capture_output=True,
        text=True,
        check=True,
        env={**os.environ, "GLIBC_TUNABLES": "glibc.cpu.hwcaps=-FMA,-FMA4,-AVX2"},
    )
    assert done.stdout.strip() not in ("", digest_of_libm())


def test_another_hypot_is_reported(monkeypatch: pytest.MonkeyPatch) -> None:
    here = digest_of_libm()
    monkeypatch.setattr(libm, "abs", lambda z: math.nextafter(abs(z), 9.0), raising=False)
    assert digest_of_libm() != here
