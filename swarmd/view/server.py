"""Serves the page of a swarm: static files and one WebSocket for each page that is open.

A page gets a frame only while it has acknowledged all but MAX_UNACKED of those before: a slow page
gets fewer frames, and nothing ever waits in a queue for it.
"""

from __future__ import annotations

import asyncio
import errno
import hmac
import http
import json
import logging
import mimetypes
import os
import socket
import ssl
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass
from importlib.resources import files
from typing import Any, Protocol
from urllib.parse import parse_qs, urlsplit

from websockets.asyncio.server import Server, ServerConnection, serve
from websockets.datastructures import Headers
from websockets.exceptions import ConnectionClosed
from websockets.http11 import Request, Response

from swarmd.core.errors import ConfigError, NetworkError, SwarmError
from swarmd.view.playback import Playback
from swarmd.view.source import Answer, Source, pack_frame, pack_scan

log = logging.getLogger(__name__)

FRAME_PERIOD = 0.1
ROWS_PERIOD = 0.5
DETAIL_PERIOD = 1.0
MAX_UNACKED = 2
MAX_MESSAGE = 64 * 1024
MAX_CLIENTS = 64
WRONG_TOKEN, ENDED = 4401, 4410
"""Codes with which a connection is closed; the page shows the reason."""
PAGE = "page"


@dataclass(frozen=True, slots=True)
class Access:
    """Tokens of pages: that of an operator, and that of one who only looks.

    Without tokens each page may command, so a server without them listens on loopback only.
    """

    operator: str = ""
    viewer: str = ""

    def role(self, token: str) -> str:
        """`operator`, `viewer`, or empty for a wrong token."""
        if not self.operator and not self.viewer:
            return "operator"
        if self.operator and hmac.compare_digest(token, self.operator):
            return "operator"
        if self.viewer and hmac.compare_digest(token, self.viewer):
            return "viewer"
        return ""


class Commander(Protocol):
    """Carries commands of pages out."""

    async def act(self, verb: str, fields: Mapping[str, Any], tell: Any) -> None:
        """Carry a command out; `tell(answer)` is called as answers come, the last one final."""


def check_address(host: str, port: int, access: Access) -> None:
    """ConfigError if the address needs a token, NetworkError if it cannot be used."""
    if host not in ("127.0.0.1", "::1", "localhost") and not access.operator:
        raise ConfigError(
            f"--bind {host}: other machines could command the robots; expected a token"
            " (--token), or 127.0.0.1"
        )
    family = socket.AF_INET6 if ":" in host else socket.AF_INET
    try:
        socket.create_server((host, port), family=family).close()
    except OSError as error:
        raise _refused(host, port, error) from error


def _refused(host: str, port: int, error: OSError) -> NetworkError:
    why = (
        "is in use"
        if error.errno == errno.EADDRINUSE
        else f"cannot be used ({os.strerror(error.errno or 0)})"
    )
    return NetworkError(f"port {port} of {host} {why}; expected a free one, such as --port 0")


class ViewServer:
    """The server of one source."""

    def __init__(self, source: Source, commander: Commander | None, access: Access) -> None:
        self.source = source
        self._commander = commander
        self._access = access
        self._clients: set[_Client] = set()
        self._tasks: set[asyncio.Task[None]] = set()
        self._server: Server | None = None
        self.frames = 0

    async def start(self, host: str, port: int, tls: ssl.SSLContext | None = None) -> str:
        """Listen, and return the address of the page. Raises as `check_address`."""
        check_address(host, port, self._access)
        try:
            self._server = await serve(
                self._talk,
                host,
                port,
                process_request=self._static,
                max_size=MAX_MESSAGE,
                compression=None,
                ssl=tls,
                logger=log,
            )
        except OSError as error:
            raise _refused(host, port, error) from error
        self._tasks.add(asyncio.create_task(self._send_frames()))
        bound = next(iter(self._server.sockets)).getsockname()
        scheme = "https" if tls is not None else "http"
        name = f"[{bound[0]}]" if ":" in bound[0] else bound[0]
        return f"{scheme}://{name}:{bound[1]}/"

    async def close(self, reason: str = "") -> None:
        """End the server; its pages show `reason` why it has ended, at most 120 bytes of it."""
        for client in list(self._clients):
            text = reason.encode()[:120].decode(errors="ignore")
            with suppress(ConnectionClosed, TimeoutError):
                await asyncio.wait_for(client.connection.close(ENDED, text), 1.0)
        for task in self._tasks:
            task.cancel()
        await asyncio.gather(*self._tasks, return_exceptions=True)
        if self._server is not None:
            self._server.close()
            await self._server.wait_closed()

    @property
    def clients(self) -> int:
        """Open pages."""
        return len(self._clients)

    # Files

    def _static(self, connection: ServerConnection, request: Request) -> Response | None:
        path = urlsplit(request.path).path
        if path == "/socket":
            if not _is_own_origin(request.headers):
                return connection.respond(http.HTTPStatus.FORBIDDEN, "a page of another site\n")
            return None
        name = "index.html" if path == "/" else path[1:]
        file = files("swarmd.view").joinpath(PAGE, name)
        if "/" in name or name.startswith(".") or not file.is_file():
            return connection.respond(http.HTTPStatus.NOT_FOUND, "there is no such page\n")
        kind = mimetypes.guess_type(name)[0] or "application/octet-stream"
        body = file.read_bytes()
        headers = Headers(
            {
                "Content-Type": f"{kind}; charset=utf-8",
                "Content-Length": str(len(body)),
                "Cache-Control": "no-cache",
                "Content-Security-Policy": (
                    "default-src 'self'; img-src 'self' data:; style-src 'self' 'unsafe-inline'"
                ),
                "X-Content-Type-Options": "nosniff",
                "Referrer-Policy": "no-referrer",
            }
        )
        return Response(200, "OK", headers, body)

    # Pages

    async def _talk(self, connection: ServerConnection) -> None:
        request = connection.request
        query = parse_qs(urlsplit(request.path if request else "").query)
        role = self._access.role(query.get("token", [""])[0])
        if not role:
            text = "The token in the address is missing or wrong; ask for the whole address."
            await connection.close(WRONG_TOKEN, text)
            return
        if len(self._clients) >= MAX_CLIENTS:
            await connection.close(WRONG_TOKEN, f"{MAX_CLIENTS} pages are open already.")
            return
        client = _Client(connection, role)
        self._clients.add(client)
        try:
            await client.send_hello(self.source)
            async for received in connection:
                await self._take(client, received)
        except ConnectionClosed:
            pass
        finally:
            self._clients.discard(client)
            self._tell_selection()

    async def _take(self, client: _Client, text: str | bytes) -> None:
        try:
            message = json.loads(text)
            kind = message["kind"]
        except (ValueError, KeyError, TypeError):
            return
        if kind == "ack":
            client.unacked = max(0, client.unacked - 1)
        elif kind == "select":
            names = message.get("names")
            known = {robot.name for robot in self.source.robots}
            client.selected = [name for name in names or () if name in known][:20]
            client.detail_at = 0.0
            self._tell_selection()
        elif kind in ("play", "seek", "choose") and self.source.playback is not None:
            if client.role == "operator":
                with suppress(TypeError, ValueError):
                    await self._play(client, self.source.playback, kind, message)
        elif kind == "act":
            task = asyncio.create_task(self._act(client, message))
            self._tasks.add(task)
            task.add_done_callback(self._tasks.discard)

    async def _play(
        self, client: _Client, playback: Playback, kind: str, message: Mapping[str, Any]
    ) -> None:
        if kind == "play":
            speed = float(message.get("speed", 1.0))
            playback.play(is_playing=bool(message.get("is_playing")), speed=speed)
        elif kind == "seek":
            playback.seek(float(message.get("time", 0.0)))
        elif message.get("run") in playback.runs:
            text = ""
            try:
                await asyncio.to_thread(playback.choose, message["run"])
            except SwarmError as error:
                text = str(error)
            client.tell({"kind": "notice", "text": text})

    async def _act(self, client: _Client, message: Mapping[str, Any]) -> None:
        id, verb = str(message.get("id"))[:64], str(message.get("verb"))[:32]

        def tell(answer: Answer) -> None:
            client.tell(
                {
                    "kind": "answer",
                    "id": id,
                    "line": answer.line,
                    "replies": answer.replies,
                    "missing": answer.missing,
                    "is_good": answer.is_good,
                    "is_final": answer.is_final,
                }
            )

        if client.role != "operator":
            tell(Answer(f"{verb}: this page may only look", is_final=True))
        elif self._commander is None:
            tell(Answer(f"{verb}: a recorded run takes no commands", is_final=True))
        else:
            await self._commander.act(verb, message, tell)

    def _tell_selection(self) -> None:
        names = {name for client in self._clients for name in client.selected}
        self.source.select(sorted(names))

    async def _send_frames(self) -> None:
        """Every 0.1 s a frame, every 0.5 s what has changed in the rows."""
        loop = asyncio.get_running_loop()
        due, rows_at = loop.time(), 0.0
        while True:
            due = max(due + FRAME_PERIOD, loop.time())
            await asyncio.sleep(due - loop.time())
            if not self._clients:
                continue
            time, places = self.source.frame()
            self.frames += 1
            frame = pack_frame(self.frames, time, places)
            has_rows = due - rows_at >= ROWS_PERIOD
            rows, more = (self._rows(), self._more()) if has_rows else ({}, [])
            rows_at = due if has_rows else rows_at
            for client in list(self._clients):
                client.advance(self.source, frame, rows if has_rows else None, more, due)

    def _rows(self) -> dict[str, str]:
        """The row of each robot as JSON."""
        return {
            name: json.dumps(row, separators=(",", ":"), allow_nan=False)
            for name, row in self.source.rows().items()
        }

    def _more(self) -> list[str]:
        boxes = [{"shape": shape.tolist(), "pose": pose} for shape, pose in self.source.boxes()]
        links = json.dumps(list(self.source.links()), separators=(",", ":"))
        found = [f'{{"kind":"rows","rows":{{}},"links":{links}}}']
        found.append(json.dumps({"kind": "boxes", "boxes": boxes}))
        if self.source.playback is not None:
            found.append(json.dumps({"kind": "playback", **self.source.playback.plain()}))
        return found


class _Client:
    """One page."""

    def __init__(self, connection: ServerConnection, role: str) -> None:
        self.connection = connection
        self.role = role
        self.selected: list[str] = []
        self.unacked = 0
        self.detail_at = 0.0
        self._rows: dict[str, str] = {}
        self._known = -1
        self._more: list[str] = []
        self._sending: asyncio.Task[None] | None = None
        self._answers: list[str] = []

    async def send_hello(self, source: Source) -> None:
        """Tell the page what it shows."""
        self._known = source.revision
        self._rows.clear()
        await self.connection.send(json.dumps(_hello(source, self.role)))

    def tell(self, message: Mapping[str, Any]) -> None:
        """Send an answer with the next turn, whatever the page has acknowledged."""
        self._answers.append(json.dumps(message))
        del self._answers[:-100]
        if self._sending is None or self._sending.done():
            self._sending = asyncio.create_task(self._send(None, [], []))

    def advance(
        self,
        source: Source,
        frame: bytes,
        rows: Mapping[str, str] | None,
        more: list[str],
        now: float,
    ) -> None:
        """Send what is due, unless the page is behind."""
        if self._sending is not None and not self._sending.done():
            return
        texts: list[str] = []
        if source.revision != self._known:
            self._known = source.revision
            self._rows.clear()
            self._more = []
            texts.append(json.dumps(_hello(source, self.role)))
        is_behind = self.unacked >= MAX_UNACKED
        if rows is not None and not is_behind:
            # Also unchanged rows: the page counts the time since it heard of a robot.
            changed = [f"{json.dumps(n)}:{r}" for n, r in rows.items() if self._rows.get(n) != r]
            same = [
                f"{json.dumps(name)}:{{}}"
                for name, row in rows.items()
                if self._rows.get(name) == row
            ]
            self._rows = dict(rows)
            texts.append('{"kind":"rows","rows":{' + ",".join(changed + same) + "}}")
            texts += [text for text in more if text not in self._more]
            self._more = more
        scans: list[bytes] = []
        if not is_behind:
            scans = self._scans(source)
            texts += self._details(source, now)
        self.unacked += not is_behind
        self._sending = asyncio.create_task(self._send(None if is_behind else frame, texts, scans))

    def _scans(self, source: Source) -> list[bytes]:
        index = {robot.name: robot.index for robot in source.robots}
        found = ((index[name], source.scan(name)) for name in self.selected if name in index)
        return [pack_scan(one, points) for one, points in found if points is not None]

    def _details(self, source: Source, now: float) -> list[str]:
        if not self.selected or now - self.detail_at < DETAIL_PERIOD:
            return []
        self.detail_at = now
        name = self.selected[-1]
        detail = source.detail(name)
        return [] if detail is None else [json.dumps({"kind": "detail", "name": name, **detail})]

    async def _send(self, frame: bytes | None, texts: list[str], scans: list[bytes]) -> None:
        answers, self._answers = self._answers, []
        with suppress(ConnectionClosed):
            for text in (*answers, *texts):
                await self.connection.send(text)
            for scan in scans:
                await self.connection.send(scan)
            if frame is not None:
                await self.connection.send(frame)


def _hello(source: Source, role: str) -> dict[str, Any]:
    return {
        "kind": "hello",
        "swarm": source.swarm,
        "source": source.kind,
        "role": role,
        "robots": [robot.plain() for robot in source.robots],
        "arena": None if source.arena is None else source.arena.plain(),
        "patterns": list(source.patterns),
        "runs": [] if source.playback is None else list(source.playback.runs),
        "playback": None if source.playback is None else source.playback.plain(),
    }


def _is_own_origin(headers: Headers) -> bool:
    """False for a page of another site, which a browser would let connect with this address."""
    origin, host = headers.get("Origin"), headers.get("Host")
    return origin is None or urlsplit(origin).netloc == host
