"""Forbids calls in a pattern's step: files, sockets, processes, clocks, shared random state."""

from __future__ import annotations

import ast
import builtins
import contextlib
import io
import os
import random
import socket
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from functools import partial
from typing import Any, NoReturn

import numpy as np

_CLOCKS = ("time", "time_ns", "monotonic", "monotonic_ns", "perf_counter", "perf_counter_ns")
_FORBIDDEN: tuple[tuple[Any, tuple[str, ...], str], ...] = (
    (builtins, ("open", "print", "input"), ""),
    (io, ("open",), ""),
    (os, ("open", "system", "fork", "urandom", "_exit", "abort", "kill"), ""),
    (socket, ("socket", "create_connection"), ""),
    (subprocess, ("Popen",), ""),
    (threading, ("Thread",), ""),
    (time, ("sleep",), "; a step never waits"),
    (time, _CLOCKS, "; the time is inputs.now"),
)
AUDIT_EVENTS = (
    *("open", "socket.connect", "socket.bind", "subprocess.Popen", "os.system", "os.fork"),
    *("os.exec", "os.posix_spawn", "os.remove", "os.rename", "os.mkdir", "os.rmdir", "os.listdir"),
    *("os.scandir", "shutil.copyfile", "shutil.rmtree", "tempfile.mkstemp", "urllib.Request"),
)
"""Audit events (PEP 578) that no code of a pattern may cause; `plugin check` reports them."""
FORBIDDEN_IMPORTS = (
    *("swarmd.drivers", "swarmd.sim", "swarmd.link", "swarmd.daemon", "swarmd.operator.cli"),
    *("swarmd.network", "swarmd.cli"),  # the same by former names
    *("zenoh", "asyncio", "time", "mujoco", "os", "io", "pathlib", "socket", "threading"),
    *("subprocess", "shutil", "tempfile"),
)
"""Modules that a pattern does not import, with all that is in them."""
_CHANCE = "; chance comes from self.context.rng"


def forbidden_imports(source: bytes) -> Iterator[tuple[int, str]]:
    """The line and the module of each import of FORBIDDEN_IMPORTS, within functions, too."""
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, ast.Import):
            names = [alias.name for alias in node.names]
        elif isinstance(node, ast.ImportFrom):
            names = [f"{node.module}.{alias.name}" for alias in node.names]
        else:
            continue
        for name in names:
            if any(f"{name}.".startswith(f"{module}.") for module in FORBIDDEN_IMPORTS):
                yield node.lineno, name


@contextlib.contextmanager
def no_side_effects(module: str) -> Iterator[None]:
    """A context in which forbidden calls, such as `open` or `time.sleep`, raise AssertionError.

    Only calls of the present thread are forbidden. `module`: the name of a pattern's module, in
    which names that were imported with `from` are guarded, too.
    """
    thread = threading.get_ident()
    # Names of callables in the module, by id: `from time import sleep` makes such a name.
    module_names: dict[int, str] = {}
    if module in sys.modules:
        for name, value in vars(sys.modules[module]).items():
            if callable(value):
                module_names[id(value)] = name
    replaced: list[tuple[Any, str, Any]] = []  # (owner, name, original value)

    def replace(owner: Any, name: str, value: Any) -> None:
        replaced.append((owner, name, getattr(owner, name)))
        setattr(owner, name, value)

    try:
        # `forbidden` raises the AssertionError in place of the callable `original`.
        for owner, name, original, forbidden in _GUARDS:
            guard = _only_in(thread, forbidden, original)
            replace(owner, name, guard)
            if id(original) in module_names:
                replace(sys.modules[module], module_names[id(original)], guard)
        with contextlib.redirect_stdout(_NoConsole()):
            yield
    finally:
        for owner, name, value in reversed(replaced):
            setattr(owner, name, value)


class _NoConsole(io.StringIO):
    def write(self, text: str) -> int:
        raise AssertionError("a step may not write to the console")


def _guards() -> Iterator[tuple[Any, str, Any, Callable[..., Any]]]:
    """(owner, name, function, replacement) of each forbidden function that this system has."""
    for owner, names, hint in _FORBIDDEN:
        for name in filter(partial(hasattr, owner), names):
            yield owner, name, getattr(owner, name), _raiser(f"{owner.__name__}.{name}", hint)
    for module in (random, np.random):
        for name in module.__all__:
            function = getattr(module, name)
            if getattr(function, "__self__", None) is not None:  # a method of the shared generator
                yield module, name, function, _raiser(f"{module.__name__}.{name}", _CHANCE)
    yield np.random, "default_rng", np.random.default_rng, _seeded_rng


def _only_in(
    thread: int, forbidden: Callable[..., Any], original: Callable[..., Any]
) -> Callable[..., Any]:
    def chosen(*args: Any, **named: Any) -> Any:
        return (forbidden if threading.get_ident() == thread else original)(*args, **named)

    return chosen


def _raiser(name: str, hint: str) -> Callable[..., NoReturn]:
    def forbidden(*_: object, **__: object) -> NoReturn:
        raise AssertionError(f"a step may not call {name}{hint}")

    return forbidden


def _seeded_rng(*seed: Any, _make: Any = np.random.default_rng) -> Any:
    if not seed or seed[0] is None:
        raise AssertionError(f"a step may not call numpy.random.default_rng unseeded{_CHANCE}")
    return _make(*seed)


_GUARDS = tuple(_guards())
