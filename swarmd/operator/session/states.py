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

from swarmd.core.clock import boottime
from swarmd.core.codec import Decoder
from swarmd.core.messages import Motion, Reason, State, Status
from swarmd.core.values import Scalar
from swarmd.operator.session.looks import SwarmWatch

if TYPE_CHECKING:
    from swarmd.operator.session.members_view import MembersView
    from swarmd.operator.session.operator import Operator
    from swarmd.operator.session.session import Session
    from swarmd.operator.session.targets import Targets

PERIOD = 0.2  # s after which a wait for a state is interrupted
MAX_WAITING = 10_000
"""States that wait for the reader; later states are dropped."""
POSE_TIME = 0.3
"""The longest wait for poses, in s: robots publish their poses ten times a second."""

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
    report: Mapping[str, Scalar] = {}  # the values that the pattern reports
    readings: Mapping[str, Scalar] = {}  # scalar sensors, such as `battery` from 0 to 1


def follow_states(
    session: Session, targets: Targets, *, seconds: float | None = None, poses: bool = False
) -> Iterator[RobotState]:
    """Yield the states of the robots in `targets` as the robots publish them.

    A robot publishes its status on each change and each second. With `poses` a state is also
    yielded for each pose, 10 a second, and the states of a robot begin with its first pose, so that
    no pose is unknown. The iterator ends after `seconds`, when the session is cancelled, or when
    the iterator is closed.
    """
    operator = session.operator
    targets = session.named_now(targets)  # labels replaced by names: a state shows no labels
    states = _States(with_poses=poses)
    is_first_view = True

    def on_view(view: MembersView) -> None:
        """Tell the user once which robots are awaited."""
        nonlocal is_first_view
        if is_first_view:
            is_first_view = False
            session.tell_awaited(view, targets)

    until = math.inf if seconds is None else boottime() + seconds
    watch = SwarmWatch(operator, on_status=states.on_status, on_view=on_view)
    operator.watch("motion", states.on_motion)
    watch.start()
    try:
        while not session.is_cancelled() and (time_left := until - boottime()) > 0:
            with suppress(queue.Empty):
                state = states.queue.get(timeout=min(time_left, PERIOD))
                if targets.matching([state.robot]):
                    yield state
    finally:
        watch.close()
        operator.unwatch("motion")


class _States:
    """A queue of states, made of the statuses and motions that robots publish.

    Threads of Zenoh call the methods. `with_poses`: each pose also gives a state, and a robot
    without a pose gives no state.
    """

    def __init__(self, *, with_poses: bool) -> None:
        self.queue: queue.Queue[RobotState] = queue.Queue(MAX_WAITING)
        self._with_poses = with_poses
        self._statuses: dict[str, Status] = {}  # the last, by robot
        self._motions: dict[str, Motion] = {}  # the last, by robot
        self._lock = threading.Lock()  # guards both

    def on_status(self, status: Status) -> None:
        with self._lock:
            self._statuses[status.robot] = status
            motion = self._motions.get(status.robot)
        if not self._with_poses or _has_pose(motion):
            _put(self.queue, status, motion)

    def on_motion(self, robot: str, payload: bytes) -> None:
        motion = _motion(payload)
        with self._lock:
            if motion.robot != robot or robot not in self._statuses:
                return
            status = self._statuses[robot]
            self._motions[robot] = motion
        if self._with_poses and _has_pose(motion):
            _put(self.queue, status, motion)


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


def _put(states: queue.Queue[RobotState], status: Status, motion: Motion | None) -> None:
    """Put the state of a robot into a queue, unless the queue is full."""
    pose_and_command = {}
    if motion is not None and _has_pose(motion):
        linear, angular, lateral = motion.safe
        pose_and_command = {"x": motion.x, "y": motion.y, "yaw": motion.yaw}
        pose_and_command |= {"linear": linear, "angular": angular, "lateral": lateral}
    state = RobotState(
        time=time.time(),
        robot=status.robot,
        state=status.state,
        reason=status.reason,
        pattern=status.pattern,
        report=status.report,
        readings=status.readings,
        **pose_and_command,
    )
    with suppress(queue.Full):
        states.put_nowait(state)
