"""A TCP relay on loopback whose bytes arrive late in both directions, in order."""

from __future__ import annotations

import contextlib
import queue
import socket
import threading
import time

_CHUNK = 65536


class SlowLink:
    """Hands on what is sent to `endpoint`, and its answers, `delay` s later; a context manager."""

    def __init__(self, target: str, delay: float) -> None:
        """`target` such as `tcp/127.0.0.1:7447`."""
        host, _, port = target.removeprefix("tcp/").rpartition(":")
        self._target, self._delay = (host, int(port)), delay
        self._listener = socket.create_server(("127.0.0.1", 0))
        self.endpoint = f"tcp/127.0.0.1:{self._listener.getsockname()[1]}"
        self._sockets = [self._listener]
        self._threads = [threading.Thread(target=self._accept)]

    def __enter__(self) -> SlowLink:
        self._threads[0].start()
        return self

    def __exit__(self, *_: object) -> None:
        for one in self._sockets:
            with contextlib.suppress(OSError):
                one.shutdown(socket.SHUT_RDWR)
            one.close()
        for thread in self._threads:
            thread.join()

    def _accept(self) -> None:
        while True:
            try:
                near, _ = self._listener.accept()
                far = socket.create_connection(self._target)
            except OSError:  # the end
                return
            for one in (near, far):
                one.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
            self._sockets += (near, far)
            self._relay(near, far)
            self._relay(far, near)

    def _relay(self, source: socket.socket, sink: socket.socket) -> None:
        under_way: queue.SimpleQueue[tuple[float, bytes]] = queue.SimpleQueue()

        def receive() -> None:
            data = b"x"
            while data:
                try:
                    data = source.recv(_CHUNK)
                except OSError:
                    data = b""
                under_way.put((time.monotonic() + self._delay, data))

        def send() -> None:
            with contextlib.suppress(OSError):
                while True:
                    due, data = under_way.get()
                    time.sleep(max(0.0, due - time.monotonic()))
                    if not data:
                        sink.shutdown(socket.SHUT_WR)
                        return
                    sink.sendall(data)

        for run in (receive, send):
            thread = threading.Thread(target=run)
            self._threads.append(thread)
            thread.start()
