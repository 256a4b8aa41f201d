"""`Actions`: the work that one event leaves to the shell (the daemon or the lockstep simulator).

`Effects` (effects.py) gathers this work while the robot handles the event.
"""

from __future__ import annotations

from collections.abc import Mapping

from msgspec import Struct

from swarmd.core.goal import GoalRecord
from swarmd.core.host_messages import CancelTrial, HostCommand, StartTrial
from swarmd.core.kin_message import KinMessage
from swarmd.core.messages import Reply
from swarmd.core.values import Twist, Value
from swarmd.robot.latches import LatchRecord
from swarmd.robot.protection.decision import Decision


class FailedCode(Struct, frozen=True):
    """A failure of provisional code: the generation of the failed load, and the fault as text."""

    generation: int
    text: str


class Actions(Struct, frozen=True, eq=False):
    """The work that one event leaves to the shell (daemon or lockstep simulator), in this order.

    1. Hand `twist` to the driver.
    2. Write `latches` and `goals` to disk.
    3. Send `trial` and `host` to the pattern host. A trial runs new code in a process of its own
       and leaves the running pattern alone.
    4. Publish `messages`, `kin_message`, the status if `has_status`, and `replies`. A reply may
       answer an earlier request: a run is answered after its pattern has been loaded.
    """

    twist: Twist  # the safe command
    decision: Decision
    # The number of the scan that the pattern's last step used; -1 if it used none.
    requested_scan_seq: int = -1
    is_idle: bool = False  # the state is idle and the base is connected
    is_stopped: bool = False  # the state is stopped, estopped or faulted
    is_quiet: bool = False  # there is no work but step 1, and the next deadline is as before
    latches: LatchRecord | None = None
    goals: GoalRecord | None = None
    trial: StartTrial | CancelTrial | None = None
    host: HostCommand | None = None
    messages: Mapping[str, Value] = {}  # the messages of the pattern, by `<pattern>/<channel>`
    has_status: bool = False
    replies: tuple[Reply, ...] = ()
    failed_code: FailedCode | None = None
    ended: str = ""  # state and reason after the end of a run; empty if no run ended
    grip: bool | None = None  # True closes the gripper, False opens it, None: no change
    kin_message: KinMessage | None = None  # what peers must know for kin
