"""A daemon of another wire version: `python -m tests.support.other_version OFFSET <options>`."""

from __future__ import annotations

import sys

from swarmd.core import codec


def main() -> None:
    codec.VERSION += int(sys.argv.pop(1))
    from swarmd.cli.daemon import main as swarmd

    swarmd()


if __name__ == "__main__":
    main()
