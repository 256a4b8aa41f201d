"""What a robot asks its shell to do after one event: values only, to be carried out at once."""

from __future__ import annotations

from collections.abc import Mapping

from msgspec import Struct

from swarmd.frames import Cancel, Command, Try
from swarmd.messages import Reply, Status
from swarmd.protection.verdict import Verdict
from swarmd.robot.latches import LatchRecord
from swarmd.values import Twist, Value


class Actions(Struct, frozen=True, eq=False):
    """In this order: hand `twist` to the driver, write `latches` down, tell the `host`, publish.

    `messages` are by `<pattern>/<channel>`. `wish_seq` is the scan that the wish behind `twist`
    used (-1: none). `is_idle` if the robot was never asked or has finished, and its base is there.
    `replies` answer earlier requests too: run is answered when its pattern is ready. `trial` goes
    to whoever carries `host`, before it, and disturbs nothing that runs.
    """

    twist: Twist
    verdict: Verdict
    wish_seq: int = -1
    is_idle: bool = False
    latches: LatchRecord | None = None
    trial: Try | Cancel | None = None
    host: Command | None = None
    messages: Mapping[str, Value] = {}
    status: Status | None = None
    replies: tuple[Reply, ...] = ()
