"""Programs of the kernel's packet filter for the sockets of a swarm. Pure but for `attach_filter`.

The programs are classic BPF (linux/filter.h; Documentation/networking/filter.rst). A program has
stages. A stage is a sequence of blocks, and a block is a sequence of tests with a verdict: accept,
drop, or go to the next stage. The first block whose tests all hold decides. A datagram for which no
block decides is dropped. Offset 0 is the UDP head of the datagram. Programs are short, since old
kernels give a socket no more than 20 kB for its filters (net.core.optmem_max).
"""

from __future__ import annotations

import ipaddress
import socket
import struct
from array import array
from collections.abc import Iterable, Sequence

from swarmd.link.carriers.flood_limits import FloodRules
from swarmd.link.datagram import ANY_SWARM, MAGIC, MAX_DATAGRAM, URGENT, Address, Kind

_LOAD = 0x20
_LOAD_HALF = 0x28
_LOAD_BYTE = 0x30
_LOAD_LENGTH = 0x80
_LOAD_MEMORY = 0x60
_STORE = 0x02
_TO_X = 0x07
_XOR_X = 0xAC
_SHIFT_LEFT = 0x64
_EQUALS = 0x15
_EXCEEDS = 0x25
_JUMP = 0x05
_RETURN = 0x06
# Special offsets of the kernel: the IP head (SKF_NET_OFF), and a random number (SKF_AD_RANDOM).
_IP_HEAD = 2**32 - 0x100000
_RANDOM = 2**32 - 0x1000 + 56
_SOURCE4 = _IP_HEAD + 12
_SOURCE6 = _IP_HEAD + 8
_SOURCE_PORT = 0
_UDP_HEAD = 8
_SO_ATTACH_FILTER = 26  # asm-generic/socket.h
_KIND_AT = _UDP_HEAD + len(MAGIC)
_TAG_AT = _UDP_HEAD + len(MAGIC) + 1
# indices of cells in the memory of the filter program
_KEY_CELL = 0
_KIND_CELL = 1

_ACCEPT = 0xFFFFFFFF  # the verdict of a block that passes the datagram
_DROP = 0
_NEXT_STAGE = -1

Instruction = tuple[int, int, int, int]  # code, jump if true, jump if false, operand
_SOCK_FILTER = struct.Struct("=HBBI")  # an instruction in the kernel's layout
Test = tuple[int, int, int, int]  # code of the load, its offset, code of the test, its operand
Block = tuple[int, Sequence[Test]]  # verdict, tests


def swarm_filter(tag: bytes, rules: FloodRules, *, is_ipv6: bool) -> bytes:
    """The BPF program that accepts the datagrams of a swarm within the flood limits `rules`.

    `tag`: the 8 bytes in the head that mark the swarm. The program also accepts `Solicit` and
    `Swarm` with the tag ANY_SWARM (zeros): questions to all swarms, and their answers. `is_ipv6`:
    the family of the socket; rules on sources of the other family are left out. Returns an array of
    struct sock_filter as bytes.

    The first stage tests the head of the datagram, the second stage the flood limits. Between the
    stages the program stores the source's key (a hash of its address) and the datagram's kind.
    """
    heads: list[Block] = [
        (_DROP, [(_LOAD_LENGTH, 0, _EXCEEDS, _UDP_HEAD + MAX_DATAGRAM)]),
        (_NEXT_STAGE, _head(tag)),
        *(
            (_NEXT_STAGE, [(_LOAD_BYTE, _KIND_AT, _EQUALS, kind), *_head(ANY_SWARM)])
            for kind in (Kind.SOLICIT, Kind.SWARM)
        ),
    ]
    limits = _limit_blocks(rules, is_ipv6)
    program = [*_stage(heads), *_keep_key_and_kind(is_ipv6), *_stage(limits)]
    return b"".join(_SOCK_FILTER.pack(*instruction) for instruction in program)


def _limit_blocks(rules: FloodRules, is_ipv6: bool) -> list[Block]:
    """The blocks of the flood limits; the first block whose tests all hold decides."""
    blocks: list[Block] = []
    # 1. Drop at random a part of the urgent datagrams of sources that exceed their urgent budget.
    for thinned, share in rules.thinned:
        for key in _source_keys([thinned], is_ipv6):
            blocks += [
                (_DROP, [_is_kind(kind), _is_from(key), _random_above(share)]) for kind in URGENT
            ]
    # 2. Accept all other datagrams of known sources.
    blocks += [(_ACCEPT, [_is_from(key)]) for key in _source_keys(rules.known, is_ipv6)]
    # 3. Of the urgent datagrams of other sources accept the share `rules.share`.
    if rules.share < 1.0:
        blocks += [(_DROP, [_is_kind(kind), _random_above(rules.share)]) for kind in URGENT]
    blocks += [(_ACCEPT, [_is_kind(kind)]) for kind in URGENT]
    # 4. Drop what is not urgent of blocked sources, or of all sources that are not known.
    blocks += [(_DROP, [_is_from(key)]) for key in _source_keys(rules.blocked, is_ipv6)]
    blocks.append((_DROP if rules.only_known else _ACCEPT, []))
    return blocks


def host_filter(hosts: Iterable[str] | None, refused: Iterable[str] = ()) -> bytes:
    """The program for a listening TCP socket that drops all packets of the hosts `refused`.

    It accepts those of `hosts`; None: those of all other hosts.
    """
    blocks: list[Block] = []
    for verdict, named in ((_DROP, refused), (_ACCEPT, hosts or ())):
        for host in map(ipaddress.ip_address, named):
            words = struct.unpack(f">{len(host.packed) // 4}I", host.packed)
            first = _SOURCE4 if host.version == 4 else _SOURCE6
            tests = [(_LOAD, first + 4 * index, _EQUALS, word) for index, word in enumerate(words)]
            blocks.append((verdict, tests))
    if hosts is None:
        blocks.append((_ACCEPT, []))
    return b"".join(_SOCK_FILTER.pack(*instruction) for instruction in _stage(blocks))


def attach_filter(sock: socket.socket, program: bytes) -> None:
    """Replace the filter of a socket. Raises OSError if the program is too long or forbidden."""
    code = array("B", program)
    filter_ = struct.pack("@HP", len(program) // 8, code.buffer_info()[0])
    sock.setsockopt(socket.SOL_SOCKET, _SO_ATTACH_FILTER, filter_)


def _head(tag: bytes) -> list[Test]:
    (magic,) = struct.unpack(">I", MAGIC)
    first, second = struct.unpack(">II", tag)
    return [
        (_LOAD, _TAG_AT, _EQUALS, first),
        (_LOAD, _TAG_AT + 4, _EQUALS, second),
        (_LOAD, _UDP_HEAD, _EQUALS, magic),
    ]


def _source_keys(sources: Iterable[Address], is_ipv6: bool) -> Iterable[int]:
    """The 32-bit key of each source whose address is of this family.

    The key is the exclusive or of the 32-bit words of the address and of the port times 2**16. Two
    sources may have the same key. An attacker gains nothing by such a pair: to forge the address of
    a known source is easier.
    """
    for text, port in sources:
        host = ipaddress.ip_address(text.partition("%")[0])
        if (host.version == 6) is is_ipv6:
            key = port << 16
            for word in struct.unpack(f">{len(host.packed) // 4}I", host.packed):
                key ^= word
            yield key


def _keep_key_and_kind(is_ipv6: bool) -> list[Instruction]:
    """Instructions that store the key of the source, and the kind of the datagram, in memory."""
    words = [_SOURCE6 + 4 * index for index in range(4)] if is_ipv6 else [_SOURCE4]
    made = [(_LOAD_HALF, 0, 0, _SOURCE_PORT), (_SHIFT_LEFT, 0, 0, 16)]
    for offset in words:
        made += [(_TO_X, 0, 0, 0), (_LOAD, 0, 0, offset), (_XOR_X, 0, 0, 0)]
    return [
        *(*made, (_STORE, 0, 0, _KEY_CELL)),
        *((_LOAD_BYTE, 0, 0, _KIND_AT), (_STORE, 0, 0, _KIND_CELL)),
    ]


def _is_kind(kind: Kind) -> Test:
    return (_LOAD_MEMORY, _KIND_CELL, _EQUALS, kind)


def _is_from(key: int) -> Test:
    return (_LOAD_MEMORY, _KEY_CELL, _EQUALS, key)


def _random_above(share: float) -> Test:
    return (_LOAD, _RANDOM, _EXCEEDS, int(share * (2**32 - 1)))


def _stage(blocks: Sequence[Block]) -> list[Instruction]:
    """The instructions of a stage: a failed test jumps to the next block, at last to a drop."""
    made: list[Instruction] = []
    end = sum(2 * len(tests) + 1 for _, tests in blocks) + 1
    for verdict, tests in blocks:
        for index, (load, offset, test, operand) in enumerate(tests):
            to_next_block = 2 * (len(tests) - index) - 1
            made += [(load, 0, 0, offset), (test, 0, to_next_block, operand)]
        if verdict == _NEXT_STAGE:
            made.append((_JUMP, 0, 0, end - len(made) - 1))
        else:
            made.append((_RETURN, 0, 0, verdict))
    return [*made, (_RETURN, 0, 0, _DROP)]
