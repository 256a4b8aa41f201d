"""A second connection to a ROS 2 base that sends nothing but zero, for the watchdog's process."""

from __future__ import annotations

import contextlib
import threading
from collections.abc import Mapping

import zenoh

from swarmd.core.values import ZERO
from swarmd.drivers.ros.cdr import encode, name_of
from swarmd.drivers.ros.from_ros import command_message
from swarmd.drivers.ros.options import RosOptions
from swarmd.drivers.ros2.key_scheme import KeyScheme
from swarmd.drivers.ros2.session import MAX_OPEN_TIME, OPEN_TIME, command_publisher, open_session

_OPEN_TIMEOUT = 0.3
_RETRY_PERIOD = 0.5


def zeros(scheme: KeyScheme, options: RosOptions, wanted: str = "") -> Mapping[str, bytes]:
    """The bytes of a zero command for each key to which a base may subscribe.

    `wanted`: the name of the message class that the base takes; empty while unknown. If Twist and
    TwistStamped have the same key, the zero has the class `wanted`.

    While `wanted` is empty, this zero is a TwistStamped with an empty frame. A base that takes a
    Twist reads 5e-324 m/s in the bytes of this zero. With the frame `base_link` the base would read
    1e180 m/s to the side.
    """
    topic = options.topic(options.cmd_vel)
    # The class `wanted` comes last, and so takes the place of another class with the same key.
    return {
        key: encode(command_message(ZERO, kind, ""))
        for kind in sorted(options.command_types, key=lambda kind: zero_hint(kind) == wanted)
        for key in scheme.command_keys(topic, kind)
    }


def zero_hint(kind: type | None) -> str:
    """The name of the message class of the base's commands, for the watchdog; empty for None."""
    return "" if kind is None else name_of(kind).rpartition("/")[2]


class RosZeroSender:
    """Sends zero on every key to which the robot may subscribe.

    A thread connects to the hub, without a limit of time, since the hub may start after the daemon.
    """

    def __init__(self, scheme: KeyScheme, options: RosOptions) -> None:
        """Not connected yet."""
        self._scheme = scheme
        self._options = options
        self._zeros = zeros(scheme, options)
        self._session: zenoh.Session | None = None
        self._publishers: Mapping[str, zenoh.Publisher] = {}
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
        """Send zero once on each key; does nothing without a connection."""
        for key, publisher in self._publishers.items():
            with contextlib.suppress(zenoh.ZError):
                publisher.put(self._zeros[key], attachment=self._scheme.attachment())

    def take_hint(self, hint: str) -> None:
        """Send zero in the message class that the base takes from now on (`zero_hint`)."""
        self._zeros = zeros(self._scheme, self._options, hint)

    def close(self) -> None:
        """Disconnect; sends nothing."""
        self._closing.set()
        self._connecting.join()
        session = self._session
        self._session = None
        self._publishers = {}
        if session is not None:
            session.close()

    def _connect(self) -> None:
        within = OPEN_TIME
        while self._session is None and not self._closing.is_set():
            session = open_session(self._options.endpoint, within=within)
            if session is None:
                within = MAX_OPEN_TIME
                self._closing.wait(_RETRY_PERIOD)
                continue
            self._session = session
            self._publishers = {key: command_publisher(session, key) for key in self._zeros}
