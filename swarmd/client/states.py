"""The states and poses of robots as they are published."""

from __future__ import annotations

import math
import queue
import threading
import time
from collections.abc import Iterator, Mapping
from contextlib import suppress
from typing import TYPE_CHECKING

from msgspec import Struct

from swarmd.client.swarm_watch import SwarmWatch
from swarmd.core.clock import boottime
from swarmd.core.codec import Decoder
from swarmd.core.messages import Motion, Reason, State, Status
from swarmd.core.values import Scalar

if TYPE_CHECKING:
    from swarmd.client.session import Session
    from swarmd.client.targets import Targets
    from swarmd.network.operator.members_view import MembersView
    from swarmd.network.operator.operator import Operator

PERIOD = 0.2  # s after which a wait for news is interrupted
MAX_WAITING = 10_000
"""States that wait for the reader; later ones are dropped."""
POSE_TIME = 0.3
"""For how long a look waits for poses at most, in s: robots send them ten times a second."""

Pose = tuple[float, float, float]
"""x and y in m, yaw in rad, by the odometry of a robot, in a frame of its own."""

_motion = Decoder(Motion)


class RobotState(Struct, frozen=True, kw_only=True):
    """The state of a robot at one moment.

    The pose is by the robot's own odometry, in a frame of its own. Unknown numbers are NaN.
    """

    time: float  # s since 1970 by this machine's clock, when the robot was heard
    robot: str
    state: State
    reason: Reason | None
    pattern: str | None
    x: float = math.nan  # m
    y: float = math.nan  # m
    yaw: float = math.nan  # rad
    linear: float = math.nan  # m/s of the safe command
    angular: float = math.nan  # rad/s of the safe command
    lateral: float = math.nan  # m/s to the left, of the safe command
    report: Mapping[str, Scalar] = {}  # of the pattern
    readings: Mapping[str, Scalar] = {}  # scalar sensors, such as `battery` from 0 to 1


def follow_states(
    session: Session, targets: Targets, *, seconds: float | None = None, poses: bool = False
) -> Iterator[RobotState]:
    """Yields a state for each status: on each change and each second; with `poses` 10 a second.

    With `poses` the states of a robot begin with its first pose, so that no pose is unknown. The
    iterator ends after `seconds`, when the session is cancelled, or when the iterator is closed.
    """
    news: queue.Queue[RobotState] = queue.Queue(MAX_WAITING)
    last: dict[str, tuple[Status, Motion | None]] = {}
    lock = threading.Lock()
    has_looked = False

    def on_status(status: Status) -> None:
        with lock:
            motion = last.get(status.robot, (status, None))[1]
            last[status.robot] = status, motion
        if not poses or _has_pose(motion):
            _put(news, status, motion)

    def on_motion(robot: str, payload: bytes) -> None:
        motion = _motion(payload)
        with lock:
            if motion.robot != robot or robot not in last:
                return
            status = last[robot][0]
            last[robot] = status, motion
        if poses and _has_pose(motion):
            _put(news, status, motion)

    def on_view(view: MembersView) -> None:
        nonlocal has_looked
        if not has_looked:
            has_looked = True
            session.tell_awaited(view, targets)

    operator = session.operator
    targets = session.named_now(targets)
    until = math.inf if seconds is None else boottime() + seconds
    watch = SwarmWatch(operator, on_status=on_status, on_view=on_view)
    operator.watch("motion", on_motion)
    watch.start()
    try:
        while not session.is_cancelled() and (left := until - boottime()) > 0:
            with suppress(queue.Empty):
                one = news.get(timeout=min(left, PERIOD))
                if targets.matching([one.robot]):
                    yield one
    finally:
        watch.close()
        operator.unwatch("motion")


def read_poses(operator: Operator, robots: frozenset[str]) -> dict[str, Pose]:
    """The poses of the robots of the last look, as far as they come within 0.3 s."""
    poses: dict[str, Pose] = {}
    is_whole = threading.Event()

    def on_motion(robot: str, payload: bytes) -> None:
        motion = _motion(payload)
        if motion.robot == robot and _has_pose(motion):
            poses[robot] = motion.x, motion.y, motion.yaw
            if robots <= poses.keys():
                is_whole.set()

    operator.watch("motion", on_motion)
    is_whole.wait(POSE_TIME if robots else 0.0)
    operator.unwatch("motion")
    return dict(poses)


def _has_pose(motion: Motion | None) -> bool:
    return motion is not None and math.isfinite(motion.x + motion.y + motion.yaw)


def _put(news: queue.Queue[RobotState], status: Status, motion: Motion | None) -> None:
    moved = {}
    if motion is not None and _has_pose(motion):
        linear, angular, lateral = motion.safe
        moved = {"x": motion.x, "y": motion.y, "yaw": motion.yaw}
        moved |= {"linear": linear, "angular": angular, "lateral": lateral}
    one = RobotState(
        time=time.time(),
        robot=status.robot,
        state=status.state,
        reason=status.reason,
        pattern=status.pattern,
        report=status.report,
        readings=status.readings,
        **moved,
    )
    with suppress(queue.Full):
        news.put_nowait(one)
