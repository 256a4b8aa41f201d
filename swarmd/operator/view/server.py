"""Serves the page of a swarm: static files, and one WebSocket for each page that is open.

`/metrics` has the figures of a living swarm for programs (`metrics.py`). The messages on the
WebSocket:

- to the page, as JSON: `hello` (robots and patterns), `rows` (statuses by robot), `detail` (of a
  selected robot), `boxes`, `links`, `programs`, `playback`, `plots`, `marks` (events), `notice` and
  `overload` (texts), `answer` (to a command) and `estop`,
- to the page, as bytes: frames (poses) and scans (`source.pack_frame`),
- from the page: `ack` (of a frame), `select` (robots), `play`, `seek` and `choose` (of a recorded
  run), `past` (a time to look back at), `act` (a command), `file` (a piece of the file of a
  command to come) and `hand` (a stick that drives a robot, `page_hand.py`).

The server remembers an emergency stop that not all robots have acknowledged: a page that opens
later shows it.
"""

from __future__ import annotations

import asyncio
import http
import json
import logging
import mimetypes
import os
import re
import ssl
from collections import deque
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import asdict
from importlib.resources import files
from typing import Any, Protocol, runtime_checkable
from urllib.parse import parse_qs

from websockets.asyncio.server import Server, ServerConnection, serve
from websockets.datastructures import Headers
from websockets.exceptions import ConnectionClosed
from websockets.http11 import Request, Response
from websockets.protocol import State

from swarmd.core.clock import boottime
from swarmd.core.errors import SwarmError
from swarmd.core.token_bucket import TokenBucket
from swarmd.operator.session.clocks import TOO_LATE, InputWatch
from swarmd.operator.view.access import (
    HEADERS,
    Access,
    bearer_token,
    check_address,
    page_url,
    unusable,
)
from swarmd.operator.view.client import Client, Rows
from swarmd.operator.view.history import History, Survey
from swarmd.operator.view.metrics import CONTENT_TYPE
from swarmd.operator.view.page_hand import HeldRobot, PageHand
from swarmd.operator.view.playback import Playback
from swarmd.operator.view.source import (
    DETAIL_KEYS,
    STOPS,
    CommandProgress,
    Measured,
    Source,
    json_of,
    pack_frame,
)

log = logging.getLogger(__name__)

FRAME_PERIOD = 0.1
ROWS_PERIOD = 0.5
FEW_ROBOTS = 50
FEW_ROWS_PERIOD = 0.2
MAX_MESSAGE = 256 * 1024
MAX_PAGES = {"operator": 16, "viewer": 100}
"""Open pages by role: many viewers keep out no operator."""
MAX_WATCHED = 20
"""Robots whose scans are watched for all pages together."""
SELECT_PERIOD = 0.5
"""Seconds between two changes of these: each change is told to the robots."""
CLOSE_TIME = 1.0
"""Seconds for a page to close its connection."""
WRONG_TOKEN = 4401
ENDED = 4410
"""Codes with which a connection is closed; the page shows the reason."""
MAX_LOAD = 3.0
"""Load of each core, as of the last minute, from which on this computer is overloaded."""
MAX_NAMES = 3
"""Robots that a page names of an event; of more it tells the number."""
PAGE = "page"
_FILE = re.compile(r"[a-z]{1,32}\.[a-z]{1,8}")
MAX_WAITING = 128
"""Connections without a role, such as those of files; a new one takes the place of the oldest."""
VIEWER_RATE = 30.0
VIEWER_BURST = 60.0
"""Messages of a read-only page that are read per second, and at once: an open page sends about ten.

A message of more than MESSAGE_BYTES counts as several."""
MESSAGE_BYTES = 4096
MAX_UNREAD = 8 * 2**20
"""Bytes that wait for a client: answers to pings have no other limit."""


class Commander(Protocol):
    """Carries out commands of pages."""

    async def act(self, verb: str, fields: Mapping[str, Any], tell: Any) -> None:
        """Carry out a command; `tell(answer)` is called with each answer, the last one final."""

    def end_estop(self) -> None:
        """Stop repeating the emergency stop, even if acknowledgements are missing."""


@runtime_checkable
class Driving(Protocol):
    """A commander whose pages may drive a robot by hand."""

    def take(self, robot: str) -> HeldRobot:
        """Take a robot by hand; blocks. SwarmError if the robot refuses."""


class ViewServer:
    """The server of one source; `frame_period` in s."""

    def __init__(
        self,
        source: Source,
        commander: Commander | None,
        access: Access,
        *,
        frame_period: float = FRAME_PERIOD,
    ) -> None:
        self.source = source
        self.frames = 0
        self._commander = commander
        self._access = access
        self._period = frame_period
        self._clients: set[Client] = set()
        self._tasks: set[asyncio.Task[None]] = set()
        self._server: Server | None = None
        self._watch = InputWatch(boottime())
        self._sent_at: deque[tuple[int, float]] = deque(maxlen=round(60.0 / frame_period))
        self._estop: dict[str, Any] | None = None
        self._waiting: dict[ServerConnection, None] = {}
        self._watched: list[str] = []
        self._fault = ""
        self._past = History(source) if source.playback is None else Survey(source)

    async def start(self, host: str, port: int, tls: ssl.SSLContext | None = None) -> str:
        """Listen, and return the address of the page. Raises as `check_address`."""
        check_address(host, port, self._access)
        try:
            self._server = await serve(
                self._talk,
                host,
                port,
                process_request=self._static,
                create_connection=limited(self._waiting),
                max_size=MAX_MESSAGE,
                compression=None,
                ssl=tls,
                logger=log,
            )
        except OSError as error:
            raise unusable(host, port, error) from error
        self._begin(self._send_frames())
        bound = next(iter(self._server.sockets)).getsockname()
        scheme = "https" if tls is not None else "http"
        return page_url(scheme, bound[0], bound[1])

    async def close(self, reason: str = "") -> None:
        """End the server; its pages show `reason`, at most 120 bytes."""
        text = reason.encode()[:120].decode(errors="ignore")
        hands = [client.hand for client in self._clients if client.hand is not None]
        await asyncio.gather(*(self._dismiss(client, text) for client in self._clients))
        await asyncio.gather(*(hand.closed() for hand in hands))
        for connection in list(self._waiting):
            connection.transport.abort()
        for task in self._tasks:
            task.cancel()
        await asyncio.gather(*self._tasks, return_exceptions=True)
        if self._server is not None:
            self._server.close()
            await self._server.wait_closed()

    async def _dismiss(self, client: Client, text: str) -> None:
        client.end()
        with suppress(ConnectionClosed, TimeoutError):  # then `abort` ends the connection
            await asyncio.wait_for(client.connection.close(ENDED, text), CLOSE_TIME)
        client.connection.transport.abort()

    @property
    def clients(self) -> int:
        """Open pages."""
        return len(self._clients)

    # Files

    def _static(self, connection: ServerConnection, request: Request) -> Response | None:
        if not self._access.allows(request.headers):
            return connection.respond(http.HTTPStatus.FORBIDDEN, "a page of another site\n")
        path, _, query = request.path.partition("?")
        if path == "/socket":
            return None
        if path == "/metrics":
            return self._metrics(connection, request, query)
        name = "index.html" if path == "/" else path[1:]
        file = files("swarmd.operator.view").joinpath(PAGE, name)
        if _FILE.fullmatch(name) is None or not file.is_file():
            return connection.respond(http.HTTPStatus.NOT_FOUND, "there is no such page\n")
        kind = mimetypes.guess_type(name)[0] or "application/octet-stream"
        body = file.read_bytes()
        about = {"Content-Type": f"{kind}; charset=utf-8", "Content-Length": str(len(body))}
        return Response(200, "OK", Headers(about | HEADERS), body)

    def _metrics(self, connection: ServerConnection, request: Request, query: str) -> Response:
        """The figures of the swarm, for whoever may open a page."""
        token = parse_qs(query).get("token", [""])[0] or bearer_token(request.headers)
        if not self._access.role(token):
            text = "expected the token of a page: Authorization: Bearer TOKEN\n"
            response = connection.respond(http.HTTPStatus.UNAUTHORIZED, text)
            response.headers["WWW-Authenticate"] = "Bearer"
            return response
        if not isinstance(self.source, Measured):
            text = "figures are of a living swarm: swarmctl view --web\n"
            return connection.respond(http.HTTPStatus.NOT_FOUND, text)
        body = self.source.metrics().encode()
        about = {"Content-Type": CONTENT_TYPE, "Content-Length": str(len(body))}
        return Response(200, "OK", Headers(about | HEADERS), body)

    # Pages

    async def _talk(self, connection: ServerConnection) -> None:
        """Serve one WebSocket connection of a page until it closes.

        The token in the address of the page gives the role: to command, or only to look. The
        connection is closed at once for a wrong token, and for a page beyond MAX_PAGES of its role.
        """
        # 1. The role.
        request = connection.request
        query = parse_qs(request.path.partition("?")[2] if request else "")
        role = self._access.role(query.get("token", [""])[0])
        if not role:
            text = "The token in the address is missing or wrong; ask for the whole address."
            await connection.close(WRONG_TOKEN, text)
            return
        open_pages = sum(client.role == role for client in self._clients)
        if open_pages >= MAX_PAGES[role]:
            # A page shows the reason of this code, and does not connect again.
            await connection.close(WRONG_TOKEN, f"{MAX_PAGES[role]} pages are open already.")
            return
        self._waiting.pop(connection, None)  # `_waiting`: the connections without a role
        # 2. Send the present state, then take the commands of the page until it closes. Meanwhile a
        #    task of the server sends the frames (poses).
        client = Client(connection, role, self._access.key)
        loop = asyncio.get_running_loop()
        budget = TokenBucket(VIEWER_RATE, VIEWER_BURST)
        self._clients.add(client)
        try:
            await client.send_hello(self.source)
            if self._estop is not None:
                client.tell(self._estop)
            async for received in connection:
                # What is not read fills the buffers of the page, and delays no other page.
                cost = min(1.0 + len(received) / MESSAGE_BYTES, VIEWER_BURST)
                while role == "viewer" and not budget.take(cost, loop.time()):
                    await asyncio.sleep(1.0 / VIEWER_RATE)
                if connection.state is not State.OPEN:  # what a closed page had sent is dropped
                    break
                self._take(client, received)
        except ConnectionClosed:
            pass  # the page was closed
        finally:
            client.end()
            self._clients.discard(client)

    def _take(self, client: Client, text: str | bytes) -> None:
        try:
            message = json.loads(text)
            kind = message["kind"]
        except (ValueError, KeyError, TypeError, RecursionError):
            return
        if kind == "ack":
            client.on_ack()
        elif kind == "select" and isinstance(names := message.get("names"), list):
            known = {robot.name for robot in self.source.robots}
            client.select([name for name in names if isinstance(name, str) and name in known])
        elif kind in ("play", "seek", "choose") and client.role == "operator":
            if (playback := self.source.playback) is not None:
                self._begin(self._play(client, playback, kind, message))
        elif kind == "past":
            client.past = None
            with suppress(TypeError, ValueError, OverflowError):  # also for null: the present
                client.past = float(message.get("time"))
        elif kind == "file" and client.role == "operator" and self._commander is not None:
            client.upload.take(message)
        elif kind == "hand":
            self._on_hand(client, message)
        elif kind == "act":
            task = self._begin(self._act(client, message))
            if message.get("verb") not in STOPS:
                client.own(task)

    def _on_hand(self, client: Client, message: Mapping[str, Any]) -> None:
        """A word of a page that drives a robot by hand."""
        if client.role != "operator" or not isinstance(self._commander, Driving):
            text = "this page may only look" if client.role != "operator" else "there is no robot"
            if message.get("do") == "take":
                client.tell({"kind": "hand", "robot": "", "is_held": False, "text": text})
            return
        if client.hand is None:
            client.hand = PageHand(self._commander.take, client.tell, boottime)
        client.hand.on_word(message, self._age_of(message.get("seen")))

    def _age_of(self, seen: Any) -> float | None:
        """Seconds since the frame `seen` was sent; None if it is not known any more."""
        now = boottime()
        return next((now - at for number, at in self._sent_at if number == seen), None)

    async def _play(
        self, client: Client, playback: Playback, kind: str, message: Mapping[str, Any]
    ) -> None:
        with suppress(TypeError, ValueError, OverflowError):  # an invalid message is ignored
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

    async def _act(self, client: Client, message: Mapping[str, Any]) -> None:
        id = str(message.get("id"))[:64]
        verb = str(message.get("verb"))[:32]

        def tell(answer: CommandProgress) -> None:
            client.tell({"kind": "answer", "id": id, **asdict(answer)})
            if verb == "estop":
                self._show_estop(id, answer)

        if client.role != "operator":
            client.tell(_refusal(id, f"{verb}: this page may only look"))
        elif self._commander is None:
            client.tell(_refusal(id, f"{verb}: a recorded run takes no commands"))
        elif verb not in STOPS and self._is_late(message.get("seen")):
            client.tell(_refusal(id, f"{verb}: not carried out: {TOO_LATE}"))
        elif verb == "end_estop":
            self._commander.end_estop()
        else:
            if verb == "estop":
                self._show_estop(id, CommandProgress("estop: sent"), is_new=True)
            fields = {**message, "code": client.upload.end(id)} if verb == "push" else message
            await self._commander.act(verb, fields, tell)

    def _is_late(self, seen: Any) -> bool:
        """True if a command that starts or changes motion may have waited too long.

        A command quotes the frame that its page had, so it arrived after that frame was sent. The
        frame is then too old, or this server did not look at its pages since.
        """
        now = boottime()
        watch = self._watch
        return not any(seen == number and watch.is_fresh(at, now) for number, at in self._sent_at)

    def _show_estop(self, id: str, answer: CommandProgress, *, is_new: bool = False) -> None:
        """Show the emergency stop on all pages; of two, the later one is shown."""
        current = self._estop
        if not is_new and (current is None or current["id"] != id):
            return
        message = {"kind": "estop", "id": id, **asdict(answer)}
        self._estop = None if answer.is_final else message
        for client in self._clients:
            client.tell(message)

    def _tell_selection(self) -> None:
        """Watch the scans of the robots that pages have selected, operators' pages first.

        The number of watched robots is limited, since scans load the robots' network.
        """
        order = sorted(self._clients, key=lambda client: client.role != "operator")
        names = dict.fromkeys(name for client in order for name in reversed(client.selected))
        watched = sorted(list(names)[:MAX_WATCHED])
        if watched != self._watched:
            self._watched = watched
            self.source.select(watched)

    async def _send_frames(self) -> None:
        """Send frames at `frame_period`, and rows less often."""
        loop = asyncio.get_running_loop()
        due = loop.time()
        rows_at = 0.0
        selected_at = 0.0
        while True:
            due = max(due + self._period, loop.time())
            await asyncio.sleep(due - loop.time())
            self._watch.look(boottime())
            try:
                if due - selected_at >= SELECT_PERIOD:
                    selected_at = due
                    self._tell_selection()
                if self._clients:
                    rows_at = self._send_frame(due, rows_at)
                self._past.advance(self.frames)
            except Exception as error:  # the next one may succeed; without any the page says so
                if repr(error) != self._fault:
                    log.exception("the page got no frame")
                self._fault = repr(error)

    def _send_frame(self, now: float, rows_at: float) -> float:
        """Send a frame to each page, and rows if due; returns the time of the last rows."""
        at, places = self.source.frame()
        frame = pack_frame(self.frames + 1, at, places)
        is_few = len(self.source.robots) <= FEW_ROBOTS
        rows = None
        if now - rows_at >= (FEW_ROWS_PERIOD if is_few else ROWS_PERIOD) - 1e-3:
            rows = self._rows()
            rows_at = now
        self.frames += 1
        self._sent_at.append((self.frames, boottime()))
        for client in list(self._clients):
            client.plot(self._past)
            moment = None if client.past is None else self._past.at(client.past)
            if moment is None:
                client.advance(self.source, frame, rows, now)
            else:
                client.look_back(self.source, moment)
        return rows_at

    def _rows(self) -> Rows:
        selected = {name for client in self._clients for name in client.selected}
        short = {}
        whole = {}
        rows = self.source.rows()
        ages = [0.0] * len(self.source.robots)
        index = {robot.name: robot.index for robot in self.source.robots}
        for name, row in rows.items():
            ages[index[name]] = float(row.get("age", 0.0))
            fields = {key: value for key, value in row.items() if key != "age"}
            if name in selected:
                whole[name] = json_of(fields)
            short[name] = json_of({k: v for k, v in fields.items() if k not in DETAIL_KEYS})
        others = [json_of({"kind": "links", "links": list(self.source.links())})]
        others.append(json_of({"kind": "programs", "programs": self.source.programs}))
        boxes = [{"shape": shape.tolist(), "pose": pose} for shape, pose in self.source.boxes()]
        others.append(json_of({"kind": "boxes", "boxes": boxes}))
        marks = [(*mark, robots[:MAX_NAMES], len(robots)) for *mark, robots in self.source.marks()]
        others.append(json_of({"kind": "marks", "marks": marks}))
        if self.source.playback is not None:
            others.append(json_of({"kind": "playback", **self.source.playback.plain()}))
        else:
            others.append(json_of({"kind": "overload", "text": overload(os.getloadavg()[0])}))
        return Rows(short, whole, ages, others)

    def _begin(self, work: Any) -> asyncio.Task[None]:
        task: asyncio.Task[None] = asyncio.create_task(work)
        self._tasks.add(task)
        task.add_done_callback(self._on_done)
        return task

    def _on_done(self, task: asyncio.Task[None]) -> None:
        self._tasks.discard(task)
        if not task.cancelled() and (error := task.exception()) is not None:
            log.error("the page's server failed", exc_info=error)


def overload(load: float) -> str:
    """A line if the computer has more work than its cores can do; `load`: of the last minute."""
    cores = os.cpu_count() or 1
    if load < MAX_LOAD * cores:
        return ""
    return (
        f"This computer is overloaded (load {load:.0f}, {cores} cores):"
        " its robots answer late or look silent."
    )


def _refusal(id: str, text: str) -> dict[str, Any]:
    return {"kind": "answer", "id": id, **asdict(CommandProgress(text, is_final=True))}


def limited(waiting: dict[ServerConnection, None]) -> type[ServerConnection]:
    """A class of WebSocket connections with limits, so that clients cannot fill the memory.

    Each connection adds itself to `waiting`. The server removes a connection from `waiting` once
    the connection has a role (operator or viewer). Beyond MAX_WAITING the oldest waiting connection
    is aborted. A client that sends requests without reading the answers is aborted, too, once more
    than MAX_UNREAD bytes wait.
    """

    class Limited(ServerConnection):
        def connection_made(self, transport: Any) -> None:
            super().connection_made(transport)
            waiting[self] = None
            if len(waiting) > MAX_WAITING:
                oldest = next(iter(waiting))
                del waiting[oldest]
                oldest.transport.abort()

        def connection_lost(self, exc: Exception | None) -> None:
            waiting.pop(self, None)
            super().connection_lost(exc)

        def data_received(self, data: bytes) -> None:
            super().data_received(data)
            if self.transport.get_write_buffer_size() > MAX_UNREAD:
                self.transport.abort()

    return Limited
