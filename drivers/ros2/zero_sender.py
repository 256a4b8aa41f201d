"""A second connection to a ROS 2 base that sends nothing but zero, for the watchdog's process."""

from __future__ import annotations

import contextlib
import threading

import zenoh

from swarmd.core.values import ZERO
from swarmd.drivers.ros.cdr import encode
from swarmd.drivers.ros.from_ros import command_message
from swarmd.drivers.ros.options import RosOptions
from swarmd.drivers.ros2.key_scheme import KeyScheme
from swarmd.drivers.ros2.session import command_publisher, open_session

_OPEN_TIMEOUT = 0.3
_CONNECT_TIMEOUT = 1.0
_RETRY_PERIOD = 0.5


class RosZeroSender:
    """Sends zero on every key to which the robot may subscribe.

    A thread connects, however long that takes: the hub may start after the daemon, or be far away.
    """

    def __init__(self, scheme: KeyScheme, options: RosOptions) -> None:
        """Not connected yet."""
        self._scheme, self._endpoint = scheme, options.endpoint
        self._keys = scheme.command_keys(options.topic(options.cmd_vel), options.command_type)
        # A base that reads this as a Twist takes the frame's name for a speed: an empty name is 0,
        # `base_link` would be 1e180 m/s to the side. The type that it wants is not known here.
        self._payload = encode(command_message(ZERO, options.command_type, ""))
        self._session: zenoh.Session | None = None
        self._publishers: tuple[zenoh.Publisher, ...] = ()
        self._closing = threading.Event()
        self._connecting = threading.Thread(target=self._connect, name="connecting", daemon=True)

    def open(self) -> None:
        """Begin to connect; returns once connected, or after 0.3 s."""
        self._connecting.start()
        self._connecting.join(_OPEN_TIMEOUT)

    @property
    def is_connected(self) -> bool:
        """True once connected; from then on the session reconnects by itself."""
        return bool(self._publishers)

    def send_zero(self) -> None:
        """Command zero once, now; nothing while there is no connection."""
        for publisher in self._publishers:
            with contextlib.suppress(zenoh.ZError):
                publisher.put(self._payload, attachment=self._scheme.attachment())

    def close(self) -> None:
        """Disconnect; sends nothing."""
        self._closing.set()
        self._connecting.join()
        session, self._session, self._publishers = self._session, None, ()
        if session is not None:
            session.close()

    def _connect(self) -> None:
        while self._session is None and not self._closing.is_set():
            session = open_session(self._endpoint, within=_CONNECT_TIMEOUT)
            if session is None:
                self._closing.wait(_RETRY_PERIOD)
                continue
            self._session = session
            self._publishers = tuple(command_publisher(session, key) for key in self._keys)
