"""Kin, compiled where it can be."""

from __future__ import annotations

from typing import TYPE_CHECKING

from swarmd.core.kernels import load_kernel

if TYPE_CHECKING:
    from swarmd.kin.kin import NO_ROBOT, Kin
else:
    _kernel = load_kernel("swarmd.kin.kin")
    NO_ROBOT, Kin = _kernel.NO_ROBOT, _kernel.Kin

__all__ = ["NO_ROBOT", "Kin"]
