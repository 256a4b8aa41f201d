"""The filter of system calls on each processor that it knows, run by an interpreter of its BPF."""

from __future__ import annotations

import os
import struct

import pytest

from swarmd.pattern_host import sandbox
from tests.pattern_host.sandbox_probes import ANY, NAMESPACES, NUMBERS

ALLOW, REFUSE, UNKNOWN = 0x7FFF0000, 0x00050001, 0x00050026
OWN = os.getpid()
POINTER = 7 << 32  # its lower half is NULL
CALLS: dict[str, tuple[int, int | None]] = {
    **NUMBERS,
    "open": (2, None),
    "openat": (257, 56),
    "kill": (62, 129),
    "ioctl": (16, 29),
    "socketpair": (53, 199),
}
TABLE: list[tuple[str, tuple[int, ...], int]] = [
    *((name, (), REFUSE) for name in sorted(ANY | {"setrlimit", "ptrace", "inotify_init1"})),
    *(("clone", (flag | 17,), REFUSE) for flag in NAMESPACES.values()),
    ("clone", (0x8000 | 17,), REFUSE),
    ("clone", (17,), ALLOW),
    ("clone", (0x3D0F00,), ALLOW),  # of pthread_create
    ("clone3", (), UNKNOWN),
    ("openat2", (), UNKNOWN),
    *(
        (name, (*[0] * place, mode | cut), result)
        for name, place in (("open", 1), ("openat", 2))
        for mode, cut, result in (
            (os.O_RDONLY, 0, ALLOW),
            (os.O_WRONLY | os.O_CREAT, os.O_TRUNC, ALLOW),
            (os.O_RDWR, os.O_TRUNC, ALLOW),
            (os.O_RDONLY, os.O_TRUNC, REFUSE),
            (os.O_ACCMODE, 0, REFUSE),
            (os.O_ACCMODE, os.O_TRUNC, REFUSE),
        )
    ),
    ("prlimit64", (0, 7, 0, POINTER), ALLOW),
    ("prlimit64", (0, 7, POINTER, 0), REFUSE),
    ("prlimit64", (0, 7, 4096, 0), REFUSE),
    ("prlimit64", (OWN, 7, 0, 0), REFUSE),
    ("kill", (OWN, 9), ALLOW),
    ("kill", (OWN + 1, 0), REFUSE),
    ("tgkill", (OWN, OWN + 1, 0), ALLOW),
    ("tgkill", (OWN + 1, OWN + 1, 0), REFUSE),
    *(("prctl", (option,), REFUSE) for option in (1, 4, 62)),
    ("prctl", (15,), ALLOW),
    ("ioctl", (0, 0x5412), REFUSE),
    ("ioctl", (0, 0x5401), ALLOW),
    ("socketpair", (1, 0x80001), ALLOW),
    ("socketpair", (1, 2), REFUSE),
    ("socketpair", (2, 1), REFUSE),
]
MACHINES = {"x86_64": 0xC000003E, "aarch64": 0xC00000B7}


def result_of(program: list[tuple[int, int, int, int]], data: bytes) -> int:
    """The end of a program of classic BPF, in the instructions that the filter has."""
    at = value = 0
    while True:
        code, if_true, if_false, k = program[at]
        at += 1
        if code == 0x20:
            (value,) = struct.unpack_from("=I", data, k)
        elif code == 0x54:
            value &= k
        elif code == 0x06:
            return k
        else:
            at += (
                if_true if {0x15: value == k, 0x35: value >= k, 0x45: value & k}[code] else if_false
            )


@pytest.mark.parametrize("machine", MACHINES)
def test_the_filter_gives_each_call_its_result(machine: str) -> None:
    column, architecture, _ = sandbox._MACHINES[machine]
    program = list(sandbox._program(column, architecture))
    assert len(program) < 4096  # BPF_MAXINSNS

    def called(number: int, *arguments: int, on: int = MACHINES[machine]) -> int:
        words = (*arguments, *[0] * 6)[:6]
        return result_of(program, struct.pack("=iIQ6Q", number, on, 0, *words))

    rows = [(name, words, result, CALLS[name][column]) for name, words, result in TABLE]
    found = [
        (name, words, called(number, *words))
        for name, words, _, number in rows
        if number is not None
    ]
    assert found == [row[:3] for row in rows if row[3] is not None]
    assert called(39, on=0x40000003) == REFUSE  # the 32-bit kernel
    assert [called(number) for number in (470, 0x40000000 | 39)] == [UNKNOWN, UNKNOWN]
