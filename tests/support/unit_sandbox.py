"""Becomes a program under the restrictions of a unit, where no systemd runs: for tests.

`python unit_sandbox.py UNIT PROGRAM ...` applies SystemCallFilter=, RestrictAddressFamilies= and
MemoryDenyWriteExecute= of the unit file to this process, as systemd does: by seccomp and prctl.
"""

from __future__ import annotations

import ctypes
import errno
import os
import socket
import subprocess
import sys
from collections import defaultdict
from pathlib import Path

_ALLOW, _REFUSE, _EQUAL = 0x7FFF0000, 0x00050000 | errno.EPERM, 4
_PR_SET_MDWE, _PR_MDWE_REFUSE_EXEC_GAIN = 65, 1
_LIBRARY = "libseccomp.so.2"


class _Comparison(ctypes.Structure):
    _fields_ = (
        ("arg", ctypes.c_uint),
        ("op", ctypes.c_int),
        ("a", ctypes.c_uint64),
        ("b", ctypes.c_uint64),
    )


def settings_of(unit: str) -> dict[str, list[str]]:
    """The values of each key of a unit, in order."""
    found = defaultdict(list)
    for line in unit.splitlines():
        key, equals, value = line.partition("=")
        if equals and not line.startswith("#"):
            found[key].append(value)
    return found


def system_calls(filters: list[str]) -> set[str]:
    """The system calls that the lines of SystemCallFilter= allow together."""
    allowed: set[str] = set()
    for line in filters:
        names = {name for word in line.removeprefix("~").split() for name in _expanded(word)}
        allowed = allowed - names if line.startswith("~") else allowed | names
    return allowed


def _expanded(word: str) -> set[str]:
    if not word.startswith("@"):
        return {word}
    listing = subprocess.run(
        ["systemd-analyze", "syscall-filter", word], capture_output=True, text=True, check=True
    ).stdout
    names = [line.strip() for line in listing.splitlines()[1:]]
    return {one for name in names if name and name[0] != "#" for one in _expanded(name)}


def restrict(unit: str) -> None:
    """Apply the restrictions to this process and all that it starts. OSError if one cannot be."""
    settings = settings_of(unit)
    if settings["MemoryDenyWriteExecute"] == ["yes"]:
        libc = ctypes.CDLL(None, use_errno=True)
        if libc.prctl(_PR_SET_MDWE, _PR_MDWE_REFUSE_EXEC_GAIN, 0, 0, 0):
            raise OSError(ctypes.get_errno(), "PR_SET_MDWE")
    library = ctypes.CDLL(_LIBRARY)
    library.seccomp_init.restype = ctypes.c_void_p
    context = ctypes.c_void_p(library.seccomp_init(_REFUSE))
    calls = system_calls(settings["SystemCallFilter"])
    for name in sorted(calls - {"socket"}):
        number = library.seccomp_syscall_resolve_name(name.encode())
        if number >= 0:  # there are calls of other machines
            library.seccomp_rule_add(context, _ALLOW, number, 0)
    number = library.seccomp_syscall_resolve_name(b"socket")
    for family in settings["RestrictAddressFamilies"][0].split():
        only = _Comparison(0, _EQUAL, getattr(socket, family), 0)
        library.seccomp_rule_add_array(context, _ALLOW, number, 1, ctypes.byref(only))
    if code := library.seccomp_load(context):
        raise OSError(-code, "seccomp_load")


if __name__ == "__main__":
    restrict(Path(sys.argv[1]).read_text())
    os.execv(sys.argv[2], sys.argv[2:])
