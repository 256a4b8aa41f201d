"""One open page: the frames it has acknowledged, its state, and the next messages to it.

A page gets a frame only while at most MAX_UNACKED earlier frames are not acknowledged, and only
after the preceding message was sent. So a slow page gets fewer frames, and no queue grows.
"""

from __future__ import annotations

import asyncio
import json
import math
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from typing import Any

from websockets.asyncio.server import ServerConnection
from websockets.exceptions import ConnectionClosed

from swarmd.operator.view.history import History, Moment, Survey
from swarmd.operator.view.page_hand import PageHand
from swarmd.operator.view.source import Source, hello_of, pack_scan
from swarmd.operator.view.upload import Upload

DETAIL_PERIOD = 1.0
MAX_UNACKED = 2
MAX_SELECTED = 20
"""Robots of which a page gets scans and commands."""
MAX_ANSWERS = 100


@dataclass(frozen=True, slots=True)
class Rows:
    """The rows of all robots as JSON, by robot."""

    short: Mapping[str, str]
    whole: Mapping[str, str]  # of selected robots, with the values that only details show
    ages: Sequence[float]  # s, by the index of the robot; inf: never heard
    others: Sequence[str] = field(default_factory=tuple)
    """Messages of links and boxes."""


class Client:
    """One page; `role` is `operator` or `viewer`. `key`: whose key commands, and what it may."""

    def __init__(self, connection: ServerConnection, role: str, key: str = "") -> None:
        self.connection = connection
        self.role = role
        self.upload = Upload()
        self._key = key
        self.hand: PageHand | None = None
        """The stick of the page; None before it was used."""
        self.selected: list[str] = []
        self.past: float | None = None
        """The time that the page looks back at; None for the present."""
        self._plotted = 0  # the number of moments whose plotted values were sent
        self._looked: Moment | None = None  # the past moment that the page shows; None: the present
        self.sent = 0
        """Frames that were sent."""
        self._unacked = 0  # frames that were sent and not acknowledged
        self._detail_at = 0.0  # s, the time of the last message of details
        self._rows: dict[str, str] = {}  # the rows that the page has, by robot
        self._known = -1  # the revision of the source that the page has
        self._others: Sequence[str] = ()  # the messages of links and boxes that the page has
        self._sending: asyncio.Task[None] | None = None
        self._answers: list[str] = []  # JSON of `tell` and `plot`, to be sent first
        self._requests: set[asyncio.Task[None]] = set()

    def on_ack(self) -> None:
        """Note that the page has received a frame."""
        self._unacked = max(0, self._unacked - 1)

    def select(self, names: Sequence[str]) -> None:
        """Set the robots that the page shows in detail, the last one first of all."""
        self.selected = list(names)[-MAX_SELECTED:]
        self._detail_at = 0.0

    async def send_hello(self, source: Source) -> None:
        """Send the description of what the page shows."""
        await self.connection.send(self._hello(source))

    def tell(self, message: Mapping[str, Any]) -> None:
        """Send an answer once the last message was sent, without waiting for acknowledgements."""
        self._answers.append(json.dumps(message))
        del self._answers[:-MAX_ANSWERS]
        if not self._is_sending:
            self._sending = asyncio.create_task(self._send([], [], None))

    def plot(self, history: History | Survey) -> None:
        """Add new values of the plots to the next messages, unless the page is behind."""
        if self._is_sending:
            return
        self._plotted, message = history.since(self._plotted)
        if message is not None:
            self._answers.append(json.dumps(message))

    def advance(self, source: Source, frame: bytes, rows: Rows | None, now: float) -> None:
        """Send what is due, unless the page is behind."""
        if self._is_sending:
            return
        texts: list[str] = []
        if source.revision != self._known:
            texts.append(self._hello(source))
        if self._unacked >= MAX_UNACKED:
            if texts or self._answers:
                self._sending = asyncio.create_task(self._send(texts, [], None))
            return
        self._looked = None
        if rows is not None:
            texts += self._changes(rows)
        texts += self._details(source, now)
        self._unacked += 1
        self.sent += 1
        self._sending = asyncio.create_task(self._send(texts, self._scans(source), frame))

    def look_back(self, source: Source, moment: Moment) -> None:
        """Send the past `moment` to a page that looks back, once, and answers that are due.

        A moment has a text (values) and a frame (poses). The frame has its old number, and a
        command of the page quotes the number of the frame that the user sees. So the server knows
        the age of what the user sees. From MAX_LATENESS s on (`operator/session/clocks.py`),
        only stops are carried out.
        """
        if self._is_sending:
            return
        texts = []
        frame = None
        if source.revision != self._known:  # the moment may show robots that the page lacks
            texts.append(self._hello(source))
            self._looked = None
        if moment is not self._looked and self._unacked < MAX_UNACKED:
            self._looked = moment
            frame = moment.frame
            self._unacked += 1
            # the present is sent anew
            self._rows = {}
            self._others = ()
            texts.append(moment.text)
        if texts or self._answers:
            self._sending = asyncio.create_task(self._send(texts, [], frame))

    def own(self, request: asyncio.Task[None]) -> None:
        """Cancel the task of a request when the page closes."""
        self._requests.add(request)
        request.add_done_callback(self._requests.discard)

    def end(self) -> None:
        """Send nothing more, cancel the requests of the page, and lose its hand."""
        if self.hand is not None:
            self.hand.close()
        for request in self._requests:
            request.cancel()
        if self._sending is not None:
            self._sending.cancel()

    @property
    def _is_sending(self) -> bool:
        return self._sending is not None and not self._sending.done()

    def _hello(self, source: Source) -> str:
        self._known = source.revision
        self._rows = {}
        self._others = ()
        self._plotted *= source.playback is None  # another run has other moments
        hello = {"kind": "hello", **hello_of(source, self.role)}
        if self._key and self.role == "operator":
            hello["key"] = self._key
        return json.dumps(hello)

    def _changes(self, rows: Rows) -> list[str]:
        """The message of the rows that changed, the ages of all robots, and other changes."""
        mine = {**rows.short, **{n: rows.whole[n] for n in self.selected if n in rows.whole}}
        changed = (f"{json.dumps(n)}:{r}" for n, r in mine.items() if self._rows.get(n) != r)
        ages = ",".join(f"{age:.1f}" if age < math.inf else "null" for age in rows.ages)
        text = f'{{"kind":"rows","rows":{{{",".join(changed)}}},"ages":[{ages}]}}'
        others = [message for message in rows.others if message not in self._others]
        self._rows = mine
        self._others = rows.others
        return [text, *others]

    def _scans(self, source: Source) -> list[bytes]:
        index = {robot.name: robot.index for robot in source.robots}
        scans = ((index[name], source.scan(name)) for name in self.selected if name in index)
        return [pack_scan(number, points) for number, points in scans if points is not None]

    def _details(self, source: Source, now: float) -> list[str]:
        if not self.selected or now - self._detail_at < DETAIL_PERIOD:
            return []
        self._detail_at = now
        name = self.selected[-1]
        detail = source.detail(name)
        return [] if detail is None else [json.dumps({"kind": "detail", "name": name, **detail})]

    async def _send(self, texts: list[str], scans: list[bytes], frame: bytes | None) -> None:
        with suppress(ConnectionClosed):  # the server ends this client (`ViewServer._talk`)
            while self._answers:
                await self.connection.send(self._answers.pop(0))
            for text in texts:
                await self.connection.send(text)
            for scan in scans:
                await self.connection.send(scan)
            if frame is not None:
                await self.connection.send(frame)
