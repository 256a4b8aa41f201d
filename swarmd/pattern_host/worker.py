"""The pattern host: the child process that loads plugin code and steps it.

The daemon starts the host with one end of a SOCK_SEQPACKET pair. The host ends with the daemon. The
host has a lower priority (nice 10) than the daemon, and the out-of-memory killer chooses the host
first. The host confines itself (`swarmd.pattern_host.sandbox`), reports the denied accesses, and
only then loads plugin code. The confined host cannot change its memory limit; the daemon can
(`host_process`). The host imports neither Zenoh nor asyncio.
"""

from __future__ import annotations

import contextlib
import io
import os
import random
import socket
import sys
import time
from pathlib import Path
from typing import cast

import msgspec
import numpy as np
from msgspec.structs import replace

import swarmd.api  # noqa: F401  # imported ahead for the first run, since all patterns import it
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
from swarmd.pattern_host.wire import decode_command, encode_event

NICE = 10


def main() -> None:
    """Entry of `python -m swarmd.pattern_host FD PARENT FOLDERS`.

    FD: the socket to the daemon. PARENT: the daemon's process id. FOLDERS: the readable and the
    secret folders of `confine`, as JSON.
    """
    run(int(sys.argv[1]), int(sys.argv[2]), sys.argv[3].encode())


def run(fd: int, parent: int, folders: bytes) -> None:
    """Serve the daemon `parent` (a process id) until the socket `fd` closes.

    `folders`: the readable and the secret folders of `confine`, as JSON.
    """
    readable, secret = msgspec.json.decode(folders, type=tuple[list[str], list[str]])
    die_with_parent(parent)
    _lower_priority()
    os.set_inheritable(fd, False)
    os.dup2(2, 1)  # prints of a pattern go to the daemon's log, line by line
    cast("io.TextIOWrapper", sys.stdout).reconfigure(line_buffering=True)
    limit_growth(LOAD_GROWTH, os.getpid())  # until the daemon sets it, at the first load
    # A forked host begins with the state of its parent, which all hosts of a simulated swarm share.
    random.seed()
    np.random.seed()  # patterns may use the global generator of numpy
    sandbox = confine(map(Path, readable), map(Path, secret))
    with socket.socket(fileno=fd) as daemon:
        try:
            daemon.send(msgspec.msgpack.encode(sandbox))
            _serve(daemon)
        except ConnectionError:  # the daemon has ended, possibly with unread answers
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
    ask_for_slices(None)  # undo the short slices inherited from the daemon
    with contextlib.suppress(OSError), open("/proc/self/oom_score_adj", "w") as file:
        file.write("800")
