"""Floods a TLS port: `python -m tests.support.handshakes KIND PORT AT_ONCE SECONDS FOLDER [RATE]`.

AT_ONCE connections are kept open, or tried, at a time; FOLDER holds the identity of the attacker.
With RATE no more than so many are begun in a second. It prints `begun`, and at its end how many
connections it began.
"""

from __future__ import annotations

import contextlib
import select
import socket
import ssl
import sys
import threading
import time
from pathlib import Path

KINDS = ("silent", "half", "slow", "abort", "junk", "foreign")
"""Nothing is sent; half a ClientHello; one byte of it a second; a ClientHello and the end; no TLS;
a whole handshake with a certificate of another authority."""
SOURCE = ("127.0.0.2", 0)
"""The host of the attacker; that of robots and operators on loopback is 127.0.0.1."""
_SLICE = 0.2  # s between two looks at the open connections


def client_hello() -> bytes:
    """The first flight of a TLS 1.3 handshake."""
    context = ssl.SSLContext(ssl.PROTOCOL_TLS_CLIENT)
    context.check_hostname = False
    sent = ssl.MemoryBIO()
    end = context.wrap_bio(ssl.MemoryBIO(), sent)
    with contextlib.suppress(ssl.SSLWantReadError):
        end.do_handshake()
    return sent.read()


class Pace:
    """At most `rate` a second; 0: no limit. Counts them."""

    def __init__(self, rate: float) -> None:
        self.count = 0
        self._rate, self._began = rate, time.monotonic()
        self._lock = threading.Lock()

    def wait(self) -> None:
        """Return when the next one may begin."""
        with self._lock:
            self.count += 1
            at = self._began + self.count / self._rate if self._rate else 0.0
        time.sleep(max(at - time.monotonic(), 0.0))


def hold(kind: str, port: int, at_once: int, until: float, pace: Pace) -> None:
    """Keep connections open that never end their handshake; those that were closed come again."""
    hello = client_hello()
    first = {"silent": b"", "half": hello[: len(hello) // 2], "slow": hello[:1]}[kind]
    held: dict[socket.socket, int] = {}
    while time.monotonic() < until:
        while len(held) < at_once and time.monotonic() < until:
            pace.wait()
            try:
                one = socket.create_connection(("127.0.0.1", port), 1.0, SOURCE)
                one.sendall(first)
            except OSError:  # the port takes no more of them now
                break
            held[one] = 1
        poll = select.poll()
        for one in held:
            poll.register(one, select.POLLIN)
        by_number = {one.fileno(): one for one in held}
        for number, _ in poll.poll(_SLICE * 1000.0):
            ended = by_number[number]
            del held[ended]
            ended.close()
        if kind == "slow":
            for one, sent in held.items():
                with contextlib.suppress(OSError):
                    one.send(hello[sent : sent + 1])
                held[one] = sent + 1
            time.sleep(1.0 - _SLICE)
    for one in held:
        one.close()


def fail(kind: str, port: int, until: float, pace: Pace, folder: Path) -> None:
    """Try handshakes that fail, one after the other."""
    hello = client_hello() if kind == "abort" else b"GET / HTTP/1.1\r\n\r\n" * 4
    context = ssl.SSLContext(ssl.PROTOCOL_TLS_CLIENT)
    context.check_hostname, context.verify_mode = False, ssl.CERT_NONE
    context.load_cert_chain(folder / "certificate.pem", folder / "key.pem")
    while time.monotonic() < until:
        pace.wait()
        with (
            contextlib.suppress(OSError),
            socket.create_connection(("127.0.0.1", port), 5.0, SOURCE) as one,
        ):
            if kind == "foreign":
                with context.wrap_socket(one) as secured:
                    secured.recv(1)  # the refusal
            else:
                one.sendall(hello)


def main(kind: str, port: int, at_once: int, seconds: float, folder: Path, rate: float) -> None:
    """Flood `127.0.0.1:port` for some seconds."""
    until, pace = time.monotonic() + seconds, Pace(rate)
    print("begun", flush=True)
    if kind in ("silent", "half", "slow"):
        hold(kind, port, at_once, until, pace)
    else:
        threads = [
            threading.Thread(target=fail, args=(kind, port, until, pace, folder))
            for _ in range(at_once)
        ]
        for one in threads:
            one.start()
        for one in threads:
            one.join()
    print(pace.count)


if __name__ == "__main__":
    name, port, at_once, seconds, folder, *rate = sys.argv[1:]
    main(name, int(port), int(at_once), float(seconds), Path(folder), float(*rate or (0,)))
