"""The pattern host: the child process that loads plugin code and steps it.

Started by exec with one end of a SOCK_SEQPACKET pair. It dies with its guardian, gives way to it
(nice 10, first for the out-of-memory killer) and may grow by 1 GB while a pattern is loaded, by
256 MB once it is. It imports neither Zenoh nor asyncio. `--describe` prints what patterns are, for
tools.
"""

from __future__ import annotations

import argparse
import contextlib
import os
import resource
import socket
import sys
import time

from msgspec.structs import replace

from swarmd.core.errors import CodecError
from swarmd.core.host_messages import Load, Loaded, PatternFailed
from swarmd.core.processes import die_with_parent
from swarmd.pattern_host.executor import PatternExecutor
from swarmd.pattern_host.loader import PatternLoader
from swarmd.pattern_host.wire import decode_command, encode_event

MEMORY_LIMIT = 256 * 1024 * 1024
LOAD_LIMIT = 1024 * 1024 * 1024
OUT_OF_MEMORY = 77
NICE = 10


def main() -> None:
    """Entry of `python -m swarmd.pattern_host.worker`."""
    parser = argparse.ArgumentParser(prog="swarmd.pattern_host.worker", description=__doc__)
    parser.add_argument("--fd", type=int, help="the guardian's socket")
    parser.add_argument("--parent", type=int, help="end with this process")
    parser.add_argument("--describe", nargs="*", metavar="PATTERN", help="print JSON lines and end")
    parser.add_argument("--plugin-dir", help="folder of one-file patterns")
    parser.add_argument("--platform", default="waffle_pi", help="whose derived defaults to show")
    args = parser.parse_args()
    if args.describe is not None:
        if args.parent is not None:
            die_with_parent(args.parent)
        from swarmd.pattern_host.inspect import print_catalog  # only tools need what it imports

        sys.exit(print_catalog(args.describe, args.plugin_dir, args.platform))
    if args.fd is None or args.parent is None:
        parser.error("the guardian gives --fd and --parent; by hand use --describe")
    die_with_parent(args.parent)
    _give_way()
    os.set_inheritable(args.fd, False)
    os.dup2(2, 1)  # what a pattern prints belongs into the daemon's log
    with socket.socket(fileno=args.fd) as daemon:
        try:
            _serve(daemon)
        except MemoryError:
            os._exit(OUT_OF_MEMORY)


def _serve(daemon: socket.socket) -> None:
    finder = PatternLoader({})
    stage = PatternExecutor(finder)
    while frame := daemon.recv(1 << 18):
        command = decode_command(frame)
        if isinstance(command, Load):
            _limit_memory(_size() + LOAD_LIMIT)
            finder.begin(command.origins)
        began = time.monotonic()
        event = stage.handle(command)
        if isinstance(event, Loaded):
            event = replace(event, took=time.monotonic() - began)
        if isinstance(command, Load):
            _limit_memory(_size() + MEMORY_LIMIT)
        if event is None:
            continue
        try:
            answer = encode_event(event)
        except CodecError as error:
            answer = encode_event(PatternFailed(event.generation, str(error)))
        try:
            daemon.send(answer)
        except (BrokenPipeError, ConnectionResetError):
            return


def _give_way() -> None:
    os.nice(NICE)
    with contextlib.suppress(OSError), open("/proc/self/oom_score_adj", "w") as file:
        file.write("800")


def _size() -> int:
    with open("/proc/self/statm") as file:
        return int(file.read().split()[0]) * resource.getpagesize()


def _limit_memory(limit: int) -> None:
    _, hard = resource.getrlimit(resource.RLIMIT_AS)
    if hard != resource.RLIM_INFINITY:
        limit = min(limit, hard)
    resource.setrlimit(resource.RLIMIT_AS, (limit, hard))


if __name__ == "__main__":
    main()
