"""Sets the options of sockets that an emulated program hands over (socket_options.c)."""

from __future__ import annotations

import errno
import socket
import threading
from pathlib import Path
from typing import Self

SOURCE = Path(__file__).with_suffix(".c")
_MAX_VALUE = 256  # bytes


class SocketOptions:
    """A context manager that serves the Unix socket `path` in a thread.

    `served`: the options that were set, as (level, name).
    """

    def __init__(self, path: Path) -> None:
        self.served: set[tuple[int, int]] = set()
        self._listener = socket.socket(socket.AF_UNIX)
        self._listener.bind(str(path))
        self._listener.listen()
        self._thread = threading.Thread(target=self._serve, daemon=True)

    def __enter__(self) -> Self:
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._listener.shutdown(socket.SHUT_RDWR)
        self._listener.close()
        self._thread.join()

    def _serve(self) -> None:
        while True:
            try:
                connection, _ = self._listener.accept()
            except OSError:  # closed
                return
            with connection:
                connection.sendall(self._answer(connection).to_bytes(4, "little"))

    def _answer(self, connection: socket.socket) -> int:
        """Set what one request wants; returns the error, or 0."""
        data, sockets, _, _ = socket.recv_fds(connection, 8 + _MAX_VALUE, 1)
        if not sockets or len(data) < 8:
            return errno.EINVAL
        level, name = (int.from_bytes(data[k : k + 4], "little") for k in (0, 4))
        with socket.socket(fileno=sockets[0]) as foreign:
            try:
                foreign.setsockopt(level, name, data[8:])
            except OSError as error:
                return error.errno or errno.EINVAL
        self.served.add((level, name))
        return 0
