"""A daemon of another wire version, and its body, which rests and listens at ENDPOINT.

`python -m tests.support.other_version OFFSET SWARM ROBOT ENDPOINT <options>`
"""

from __future__ import annotations

import sys

from swarmd.core import codec


def main() -> None:
    offset, swarm, robot, endpoint = sys.argv[1:5]
    del sys.argv[1:5]
    codec.VERSION += int(offset)
    from swarmd.operator.cli.daemon import main as swarmd
    from tests.support.fake_body import resting_body

    with resting_body(swarm, robot, endpoint):
        swarmd()


if __name__ == "__main__":
    main()
