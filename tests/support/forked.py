"""What forks of the server run: `swarmd` and `swarmctl`, on a host of their own if one is named."""

from __future__ import annotations

import ctypes
import faulthandler
import os
import sys

CLONE_NEWNS, CLONE_NEWNET = 0x20000, 0x40000000
_MS_RDONLY, _MS_REC, _MS_SLAVE, _MNT_DETACH = 1, 0x4000, 0x80000, 2


def enter_network(namespace: str) -> None:
    """Move this thread into a network namespace."""
    with open(f"/run/netns/{namespace}") as file:
        _call("setns", file.fileno(), CLONE_NEWNET)


def enter(namespace: str) -> None:
    """Move this process into a network namespace with its /sys, as `ip netns exec` does."""
    enter_network(namespace)
    read_only = _MS_RDONLY if os.statvfs("/sys").f_flag & os.ST_RDONLY else 0
    _call("unshare", CLONE_NEWNS)
    _call("mount", b"", b"/", b"none", _MS_SLAVE | _MS_REC, None)
    _call("umount2", b"/sys", _MNT_DETACH)
    _call("mount", namespace.encode(), b"/sys", b"sysfs", read_only, None)


def _call(name: str, *arguments: object) -> None:
    libc = ctypes.CDLL(None, use_errno=True)
    if getattr(libc, name)(*arguments) != 0:
        number = ctypes.get_errno()
        raise OSError(number, f"{name}: {os.strerror(number)}")


def main() -> None:
    """Run a program: `daemon`, `swarmd` or `swarmctl`, a network namespace, and its arguments."""
    program, namespace, *words = sys.argv[1:]
    if namespace:
        enter(namespace)
    sys.path[:0] = filter(None, os.environ.get("PYTHONPATH", "").split(os.pathsep))
    if program == "daemon":
        from tests.support import forked_fleet_daemon

        sys.argv[1:] = words
        forked_fleet_daemon.main()
    from swarmd.core.processes import die_with_parent
    from swarmd.operator.cli import daemon, swarmctl

    faulthandler.enable()
    *words, _, parent = words
    die_with_parent(int(parent))
    (swarmctl if program == "swarmctl" else daemon).main(words)
