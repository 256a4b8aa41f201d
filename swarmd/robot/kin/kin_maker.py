"""Makes kin when a robot first needs it."""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from swarmd.robot.kin.kin import Kin


class KinMaker:
    """Makes the `Kin` of a robot. An object, since the memory of a robot holds no function."""

    def __call__(self, middle: float, resets: int, is_partial: bool, radius: float) -> Kin:
        """The `Kin` of a robot. Its kernel is loaded here, since most robots never need it."""
        from swarmd.robot.kin.kin import Kin  # 11 ms of a start

        return Kin(middle, resets, is_partial, radius)
