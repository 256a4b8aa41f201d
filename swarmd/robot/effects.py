"""`Effects`: the changes that one event makes for the shell, gathered before they become `Actions`.

The shell is the daemon or the lockstep simulator. A kernel (see `core/kernels.py`), in one unit
with ticker.py.
"""

from __future__ import annotations

from types import MappingProxyType
from typing import TYPE_CHECKING

from msgspec.structs import replace

from swarmd.core import cython_shadow as cython
from swarmd.core.host_messages import KillHost, Load, SetParams, Step

if TYPE_CHECKING:
    from collections.abc import Mapping

    from swarmd.core.host_messages import CancelTrial, HostCommand, StartTrial
    from swarmd.core.kin_message import KinMessage
    from swarmd.core.messages import Reply
    from swarmd.core.values import Value
    from swarmd.robot.actions import FailedCode

_NO_MESSAGES: Mapping[str, Value] = MappingProxyType({})


@cython.cclass
class Effects:
    """The effects of one event at `now`, gathered until the robot makes `Actions` of them.

    `is_routine`: the event cannot have changed the lifecycle, so its deadlines need no new check:
    a tick, a scan, or the answer to a step that ends no run. `is_latched`: the emergency stops that
    hold the robot have changed. The fields from `trial` on mean the same as in `Actions`.
    """

    now: float
    is_tick: bool
    is_routine: bool
    is_latched: bool
    is_new_scan: bool
    is_new_run: bool
    trial: StartTrial | CancelTrial | None
    messages: Mapping[str, Value]
    replies: tuple[Reply, ...]
    host: HostCommand | None
    failed_code: FailedCode | None
    ended: str
    grip: bool | None
    kin_message: KinMessage | None

    def __init__(self, now: float) -> None:
        self.now = now
        self.messages = _NO_MESSAGES
        self.replies = ()
        self.ended = ""

    def command_host(self, command: KillHost | Load | SetParams | Step) -> None:
        """Choose the only command of this event for the pattern host, which runs patterns.

        1. KillHost and Load decide which pattern the host holds: they replace any earlier command.
           A Load after a KillHost asks for a fresh host.
        2. SetParams and Step replace no earlier command: they are for the pattern that the host
           holds now, and an earlier KillHost or Load has removed this pattern. Of SetParams and
           Step the first counts.
        """
        if isinstance(command, (SetParams, Step)) and self.host is not None:
            return
        if isinstance(command, Load) and isinstance(self.host, KillHost):
            command = replace(command, is_fresh=True)
        self.host = command
