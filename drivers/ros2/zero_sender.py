"""A second connection to a ROS base that can say nothing but zero, for the stopper's process."""

from __future__ import annotations

import contextlib
import threading

import zenoh

from swarmd.core.values import ZERO
from swarmd.drivers.ros.cdr import encode
from swarmd.drivers.ros.from_ros import stamped_message, twist_message
from swarmd.drivers.ros.messages import Twist, TwistStamped
from swarmd.drivers.ros.options import RosOptions, topic
from swarmd.drivers.ros2.key_scheme import KeyScheme
from swarmd.drivers.ros2.session import commanding, open_session

_AT_OPENING = 0.3
_TRY_FOR = 1.0
_AGAIN_AFTER = 0.5


class RosZeroSender:
    """Commands zero on every key on which the robot may listen.

    A thread connects, however long that takes: what listens there may start after the robot's
    daemon, and be far away.
    """

    def __init__(self, scheme: KeyScheme, endpoint: str, keys: tuple[str, ...], payload: bytes):
        """Not connected yet; `payload` is the zero as the robot wants it."""
        self._scheme, self._endpoint = scheme, endpoint
        self._keys, self._payload = keys, payload
        self._session: zenoh.Session | None = None
        self._publishers: tuple[zenoh.Publisher, ...] = ()
        self._closing = threading.Event()
        self._connecting = threading.Thread(target=self._connect, name="connecting", daemon=True)

    def open(self) -> None:
        """Begin to connect; returns when it is done, or after a moment."""
        self._connecting.start()
        self._connecting.join(_AT_OPENING)

    @property
    def is_connected(self) -> bool:
        """Whether it has found the hub; from then on the session finds it again by itself."""
        return bool(self._publishers)

    def send_zero(self) -> None:
        """Command zero once, now; nothing while there is no connection."""
        for publisher in self._publishers:
            with contextlib.suppress(zenoh.ZError):
                publisher.put(self._payload, attachment=self._scheme.attachment())

    def close(self) -> None:
        """Disconnect; commands nothing."""
        self._closing.set()
        self._connecting.join()
        session, self._session, self._publishers = self._session, None, ()
        if session is not None:
            session.close()

    def _connect(self) -> None:
        while self._session is None and not self._closing.is_set():
            session = open_session(self._endpoint, within=_TRY_FOR)
            if session is None:
                self._closing.wait(_AGAIN_AFTER)
                continue
            self._session = session
            self._publishers = tuple(commanding(session, key) for key in self._keys)


def zero_sender_of(scheme: KeyScheme, options: RosOptions) -> RosZeroSender:
    """The sender for a robot with these options."""
    is_stamped = options.cmd_vel_type == "twist_stamped"
    # A base that takes this for a Twist reads the frame's name as a speed: none is 0, where
    # `base_link` would be 1e180 m/s to the side. What it wants cannot be asked here.
    message = stamped_message(ZERO, "") if is_stamped else twist_message(ZERO)
    keys = scheme.command_keys(
        topic(options, options.cmd_vel), TwistStamped if is_stamped else Twist
    )
    return RosZeroSender(scheme, options.endpoint, keys, encode(message))
