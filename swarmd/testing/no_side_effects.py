"""The ways out of a pattern's step: files, sockets, processes, clocks, sleep and the console."""

from __future__ import annotations

import builtins
import contextlib
import io
import os
import socket
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from typing import Any
from unittest.mock import patch

_DOORS: tuple[tuple[Any, str], ...] = (
    (builtins, "open"),
    (builtins, "print"),
    (builtins, "input"),
    (io, "open"),
    (os, "open"),
    (os, "system"),
    (os, "fork"),
    (os, "urandom"),
    (socket, "socket"),
    (socket, "create_connection"),
    (subprocess, "Popen"),
    (threading, "Thread"),
    (time, "sleep"),
    (time, "time"),
    (time, "time_ns"),
    (time, "monotonic"),
    (time, "monotonic_ns"),
    (time, "perf_counter"),
    (time, "perf_counter_ns"),
)


@contextlib.contextmanager
def closed(module: str) -> Iterator[None]:
    """Each of them raises AssertionError, also by a name that this module has imported it under."""
    own = sys.modules.get(module)
    with contextlib.ExitStack() as stack:
        for owner, name in _DOORS:
            door = getattr(owner, name)
            error = AssertionError(f"a pattern's step may not call {owner.__name__}.{name}")
            places = (
                [(own, key) for key, value in vars(own).items() if value is door] if own else []
            )
            for place, key in ((owner, name), *places):
                stack.enter_context(patch.object(place, key, side_effect=error))
        stack.enter_context(contextlib.redirect_stdout(_Mute()))
        yield


class _Mute(io.StringIO):
    def write(self, text: str) -> int:
        raise AssertionError("a pattern's step may not write to the console")
