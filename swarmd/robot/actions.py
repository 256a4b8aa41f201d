"""The effects of one event on a robot, handed to the shell; `Effects` (effects.py) gathers them."""

from __future__ import annotations

from collections.abc import Mapping

from msgspec import Struct

from swarmd.core.goal import GoalRecord
from swarmd.core.host_messages import CancelTrial, HostCommand, StartTrial
from swarmd.core.messages import Reply
from swarmd.core.values import Twist, Value
from swarmd.protection.decision import Decision
from swarmd.robot.latches import LatchRecord


class FailedCode(Struct, frozen=True):
    """Provisional code that failed: the generation of its load, and why."""

    generation: int
    text: str


class Actions(Struct, frozen=True, eq=False):
    """The work of the shell after one event, in this order.

    Hand `twist` to the driver, write `latches` and `goals` to disk, send `trial` and `host` to the
    pattern host, publish `messages` (by `<pattern>/<channel>`), the status and `replies`.
    `requested_scan_seq` is the scan behind `twist` (-1: none). `is_idle`: the state is idle and the
    base is connected. `is_stopped`: the state is stopped, estopped or faulted. `replies` may answer
    earlier requests: a run is answered when its pattern has been loaded. A `trial` has a process of
    its own and leaves the running pattern alone. `has_status`: publish `Robot.status`. `is_quiet`:
    there is nothing but the command, and `wake_at` is as before. `failed_code`: provisional code
    has failed. `ended`: state and reason after the end of a run; empty if none ended. `grip`: close
    the gripper, or open it.
    """

    twist: Twist
    decision: Decision
    requested_scan_seq: int = -1
    is_idle: bool = False
    is_stopped: bool = False
    is_quiet: bool = False
    latches: LatchRecord | None = None
    goals: GoalRecord | None = None
    trial: StartTrial | CancelTrial | None = None
    host: HostCommand | None = None
    messages: Mapping[str, Value] = {}
    has_status: bool = False
    replies: tuple[Reply, ...] = ()
    failed_code: FailedCode | None = None
    ended: str = ""
    grip: bool | None = None
