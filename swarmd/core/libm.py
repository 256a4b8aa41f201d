"""Tells apart the variants of the C library's mathematical functions."""

from __future__ import annotations

import hashlib
import math
import struct

_ARGUMENTS = 400


def digest_of_libm() -> str:
    """8 hex digits of what the C library's mathematical functions give for fixed arguments.

    The C library has variants of these functions for processors with and without FMA, which give
    other last bits, and chooses by the processor and by GLIBC_TUNABLES. The digest shows a choice
    whatever made it.
    """
    arguments = [0.0137 * k for k in range(1, _ARGUMENTS)]
    functions = (math.sin, math.cos, math.tan, math.atan, math.exp, math.log)
    values = [function(x) for function in functions for x in arguments]
    # Kernels call hypot of C, as the absolute value of a complex number does.
    values += [y for x in arguments for y in (math.atan2(x, 1.7), abs(complex(x, 1.7)))]
    values += [math.pow(x, 1.3) for x in arguments]
    return hashlib.sha256(struct.pack(f"<{len(values)}d", *values)).hexdigest()[:8]
