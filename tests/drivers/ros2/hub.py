"""A Zenoh router in a process of its own, to be frozen.

python -m tests.drivers.ros2.hub ENDPOINT
"""

from __future__ import annotations

import signal
import sys

from tests.drivers.ros2.robots import open_session


def main(endpoint: str) -> None:
    session = open_session("router", "listen/endpoints", endpoint)
    print("ready", flush=True)
    signal.pause()
    session.close()


if __name__ == "__main__":
    main(sys.argv[1])
