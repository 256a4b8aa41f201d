"""Programs of the kernel's packet filter for the sockets of a swarm. Pure: values in, bytes out.

Classic BPF (linux/filter.h; Documentation/networking/filter.rst). A program is a row of blocks: the
first one whose tests all hold decides. It sees a datagram from its UDP head on.
"""

from __future__ import annotations

import struct
from collections.abc import Iterable, Sequence

from swarmd.network.datagram import ANY_SWARM, MAGIC, MAX_DATAGRAM, Kind

_UDP_HEAD = 8
_LOAD, _LOAD_HALF, _LOAD_BYTE, _LOAD_LENGTH = 0x20, 0x28, 0x30, 0x80
_EQUALS, _EXCEEDS, _RETURN = 0x15, 0x25, 0x06
_ACCEPT, _DROP = 0xFFFFFFFF, 0

Instruction = tuple[int, int, int, int]  # code, jump if true, jump if false, operand
Test = tuple[int, int, int, int]  # code of the load, its offset, code of the test, its operand

_KIND_AT, _TAG_AT = _UDP_HEAD + len(MAGIC), _UDP_HEAD + len(MAGIC) + 1


def swarm_filter(tag: bytes) -> bytes:
    """Accepts the datagrams of a swarm, and `Solicit` and `Swarm` of any swarm."""
    return _program(
        [
            (_DROP, [(_LOAD_LENGTH, 0, _EXCEEDS, _UDP_HEAD + MAX_DATAGRAM)]),
            (_ACCEPT, _head(tag)),
            *((_ACCEPT, [_kind(kind), *_head(ANY_SWARM)]) for kind in (Kind.SOLICIT, Kind.SWARM)),
        ]
    )


def _head(tag: bytes) -> list[Test]:
    (magic,) = struct.unpack(">I", MAGIC)
    first, second = struct.unpack(">II", tag)
    return [
        (_LOAD, _TAG_AT, _EQUALS, first),
        (_LOAD, _TAG_AT + 4, _EQUALS, second),
        (_LOAD, _UDP_HEAD, _EQUALS, magic),
    ]


def _kind(kind: Kind) -> Test:
    return (_LOAD_BYTE, _KIND_AT, _EQUALS, kind)


def _program(blocks: Iterable[tuple[int, Sequence[Test]]]) -> bytes:
    """The program as the kernel reads it (struct sock_filter); what no block decides is dropped."""
    made: list[Instruction] = []
    for verdict, tests in blocks:
        for index, (load, offset, test, operand) in enumerate(tests):
            to_next_block = 2 * (len(tests) - index) - 1
            made += [(load, 0, 0, offset), (test, 0, to_next_block, operand)]
        made.append((_RETURN, 0, 0, verdict))
    made.append((_RETURN, 0, 0, _DROP))
    return b"".join(struct.pack("=HBBI", *one) for one in made)
