"""The pattern host: the child process that loads plugin code and steps it.

The daemon starts the host with one end of a SOCK_SEQPACKET pair. The host ends with the daemon and
yields to the daemon (nice 10, first for the out-of-memory killer). Before the host loads plugin
code it confines itself (`swarmd.pattern_host.sandbox`) and reports what the kernel denies. From
then on only the daemon can change the host's limit of memory (`host_process`). The host imports
neither Zenoh nor asyncio.
"""

from __future__ import annotations

import contextlib
import io
import os
import socket
import sys
import time
from pathlib import Path
from typing import cast

import msgspec
from msgspec.structs import replace

import swarmd.api  # noqa: F401  # all patterns import it: a first run need not wait for that
from swarmd.core.errors import CodecError
from swarmd.core.host_messages import Load, Loaded, PatternFailed
from swarmd.core.processes import (
    LOAD_GROWTH,
    OUT_OF_MEMORY,
    ask_for_slices,
    die_with_parent,
    limit_growth,
)
from swarmd.pattern_host.executor import PatternExecutor
from swarmd.pattern_host.loader import PatternLoader
from swarmd.pattern_host.sandbox import confine
from swarmd.pattern_host.wire import decode_command, encode_event, encode_sandbox

NICE = 10


def main() -> None:
    """Entry of `python -m swarmd.pattern_host FD PARENT FOLDERS`.

    The daemon's socket and id, and the folders that `confine` takes, readable and secret, as JSON.
    """
    run(int(sys.argv[1]), int(sys.argv[2]), sys.argv[3].encode())


def run(fd: int, parent: int, folders: bytes) -> None:
    """Be the host of the daemon `parent` until its socket `fd` closes; `folders` as in `main`."""
    readable, secret = msgspec.json.decode(folders, type=tuple[list[str], list[str]])
    die_with_parent(parent)
    _lower_priority()
    os.set_inheritable(fd, False)
    os.dup2(2, 1)  # what a pattern prints belongs into the daemon's log, line by line
    cast("io.TextIOWrapper", sys.stdout).reconfigure(line_buffering=True)
    limit_growth(LOAD_GROWTH, os.getpid())  # until the daemon sets it, at the first load
    sandbox = confine(map(Path, readable), map(Path, secret))
    with socket.socket(fileno=fd) as daemon:
        try:
            daemon.send(encode_sandbox(sandbox))
            _serve(daemon)
        except ConnectionError:  # the daemon ended, perhaps with answers that it had not read
            return
        except MemoryError:
            os._exit(OUT_OF_MEMORY)


def _serve(daemon: socket.socket) -> None:
    loader = PatternLoader({})
    executor = PatternExecutor(loader)
    while frame := daemon.recv(1 << 18):
        command = decode_command(frame)
        if isinstance(command, Load):
            loader.begin(command.origins, command.digests)
        began = time.monotonic()
        event = executor.handle(command)
        if isinstance(event, Loaded):
            event = replace(event, took=time.monotonic() - began)
        if event is None:
            continue
        try:
            answer = encode_event(event)
        except CodecError as error:
            answer = encode_event(PatternFailed(event.generation, str(error)))
        daemon.send(answer)


def _lower_priority() -> None:
    os.nice(NICE)
    ask_for_slices(None)  # short ones are for the daemon, which started this process
    with contextlib.suppress(OSError), open("/proc/self/oom_score_adj", "w") as file:
        file.write("800")
