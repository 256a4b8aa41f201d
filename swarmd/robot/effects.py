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

_NO_MESSAGES: Mapping[str, Value] = cython.declare(object, MappingProxyType({}))


@cython.final
@cython.auto_pickle(False)
@cython.cclass
class Effects:
    """The effects of one event at `now`, gathered until the robot makes `Actions` of them.

    `is_routine`: the event cannot have changed the lifecycle, so its deadlines need no new check:
    a tick, a scan, or the answer to a step that ends no run. `is_latched`: the emergency stops that
    hold the robot have changed. The fields from `trial` on mean the same as in `Actions`.
    """

    now = cython.declare(cython.double, visibility="readonly")
    is_tick = cython.declare(cython.bint, visibility="public")
    is_routine = cython.declare(cython.bint, visibility="public")
    is_latched = cython.declare(cython.bint, visibility="public")
    is_new_scan = cython.declare(cython.bint, visibility="public")
    is_new_run = cython.declare(cython.bint, visibility="public")
    trial: StartTrial | CancelTrial | None = cython.declare(object, visibility="public")
    messages: Mapping[str, Value] = cython.declare(object, visibility="public")
    replies: tuple[Reply, ...] = cython.declare(tuple, visibility="public")
    host: HostCommand | None = cython.declare(object, visibility="public")
    failed_code: FailedCode | None = cython.declare(object, visibility="public")
    ended: str = cython.declare(object, visibility="public")
    grip: bool | None = cython.declare(object, visibility="public")
    kin_message: KinMessage | None = cython.declare(object, visibility="public")

    def __init__(self, now: cython.double) -> None:
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
