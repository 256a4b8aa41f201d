"""`Protection`, compiled or interpreted: its source is the kernel arbiter.py."""

from __future__ import annotations

from typing import TYPE_CHECKING

from swarmd.core.kernels import load_kernel

if TYPE_CHECKING:
    from swarmd.protection.arbiter import Protection
else:
    Protection = load_kernel("swarmd.protection.arbiter").Protection

__all__ = ["Protection"]
