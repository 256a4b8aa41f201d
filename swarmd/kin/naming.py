"""Kin, compiled where it can be."""

from __future__ import annotations

from typing import TYPE_CHECKING

from swarmd.core.kernels import load_kernel

if TYPE_CHECKING:
    from swarmd.kin.kin import NO_ROBOT, Kin, hear_many
else:
    _kernel = load_kernel("swarmd.kin.kin")
    NO_ROBOT = _kernel.NO_ROBOT
    Kin = _kernel.Kin
    hear_many = _kernel.hear_many

__all__ = ["NO_ROBOT", "Kin", "hear_many"]
