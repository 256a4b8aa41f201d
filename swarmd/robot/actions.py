"""The effects of one event on a robot: gathered in `Effects`, handed to the shell as `Actions`."""

from __future__ import annotations

from collections.abc import Mapping

from msgspec import Struct, structs

from swarmd.core.goal import GoalRecord
from swarmd.core.host_messages import (
    CancelTrial,
    HostCommand,
    KillHost,
    Load,
    SetParams,
    StartTrial,
    Step,
)
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
    has failed. `ended`: state and reason after the end of a run; empty if none ended.
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


class Effects(Struct, eq=False):
    """The effects of one event at `now`, gathered until the robot settles them into `Actions`.

    `is_routine`: the event is a tick, a scan or the answer to a step, and has not changed the
    lifecycle, but for the requested command.
    """

    now: float
    is_tick: bool = False
    is_routine: bool = False
    is_latched: bool = False
    is_new_scan: bool = False
    is_new_run: bool = False
    trial: StartTrial | CancelTrial | None = None
    messages: Mapping[str, Value] = {}
    replies: tuple[Reply, ...] = ()
    host: HostCommand | None = None
    failed_code: FailedCode | None = None
    ended: str = ""

    def command_host(self, command: KillHost | Load | SetParams | Step) -> None:
        """Choose the one command of this event for the pattern host.

        KillHost and Load decide which pattern the host holds, so the later of them wins; a Load
        after a KillHost asks for a fresh host. SetParams and Step are meant for the pattern that
        the host holds now, so they never replace another command.
        """
        if isinstance(command, SetParams | Step) and self.host is not None:
            return
        if isinstance(command, Load) and isinstance(self.host, KillHost):
            command = structs.replace(command, is_fresh=True)
        self.host = command
