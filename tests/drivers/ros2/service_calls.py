"""Calls of a robot's services, as a client of each middleware makes them."""

from __future__ import annotations

import struct
import threading
import time
from typing import Any

import zenoh

from tests.drivers.ros2.robots import Robot, ZenohRobot
from tests.support.processes import wait_until
from tests.support.ros2_types import TriggerResponse

EMPTY = b"\0\1\0\0\0"
CALL = struct.Struct("<qqB16s")
# Published by rmw_zenoh and pyzeros for std_srvs/srv/Trigger.
TRIGGER = (
    "std_srvs::srv::dds_::Trigger_/"
    "RIHS01_eeff2cd6fa5ad9d27cdf4dec64818317839b62f212a91e6b5304b634b2062c5f"
)


class Call:
    """A call on its way. `stamped_ago`: s that the caller's stamp lies back (rmw_zenoh)."""

    def __init__(
        self, robot: Robot, service: str, *, stamped_ago: float = 0.0, **changes: Any
    ) -> None:
        self.replies: list[zenoh.Reply] = []
        self._ended = threading.Event()
        key, attachment = service, b"rqh" + bytes(16) + b"\1"
        if isinstance(robot, ZenohRobot):
            hashed = TRIGGER
            if robot.is_humble:
                hashed = TRIGGER.partition("/")[0] + "/TypeHashNotSupported"
            key = f"{robot.domain}/{service}/{hashed}"
            stamp = round(1e9 * (time.time() - stamped_ago))
            attachment = CALL.pack(7, stamp, 16, b"c" * 16)
        target = zenoh.QueryTarget.ALL_COMPLETE
        own = {"payload": EMPTY, "attachment": attachment, "key": key, "target": target}
        given = {**own, **changes}
        robot.hub.get(
            given.pop("key"),
            zenoh.handlers.Callback(self.replies.append, self._ended.set, indirect=False),
            timeout=20.0,
            **given,
        )

    @property
    def has_ended(self) -> bool:
        return self._ended.is_set()

    @property
    def answers(self) -> list[TriggerResponse]:
        """All answers so far."""
        oks = [reply.ok for reply in self.replies if reply.ok is not None]
        return [TriggerResponse.deserialize(ok.payload.to_bytes()) for ok in oks]

    def answer(self) -> TriggerResponse:
        """Wait for the end; the one answer."""
        wait_until(lambda: self.has_ended, "the call ends")
        (answer,) = self.answers
        return answer
