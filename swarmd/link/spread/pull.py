"""Pulls a named blob (a roster, a table or a pushed pattern) from a peer, and serves blobs.

Robots have no lasting Zenoh links to each other. A pull opens a short session to the address of one
peer, asks for pieces on `swarm/<swarm>/<peer>/shared/<what>/<asker>`, compares the SHA-256 of the
whole blob, and closes the session. A daemon pulls one blob at a time, at most PULL_RATE per second.
"""

from __future__ import annotations

import asyncio
import hashlib
from collections.abc import Awaitable, Callable
from contextlib import suppress
from functools import partial
from typing import Annotated

import zenoh
from msgspec import Meta, Struct

from swarmd.core.bounds import Count, Line, Word, keep_newest
from swarmd.core.clock import boottime
from swarmd.core.codec import Decoder, encode
from swarmd.core.errors import CodecError, NetworkError
from swarmd.core.keys import SHARED, build
from swarmd.core.threads import hand_over
from swarmd.core.token_bucket import TokenBucket
from swarmd.link.carriers.bus import Query, ZenohBus
from swarmd.link.carriers.inbound_queue import FAILED, DropCounter
from swarmd.link.carriers.session import open_in_thread, open_pull_session
from swarmd.link.datagram import Address
from swarmd.link.keys.identity import Identity
from swarmd.link.settings import NetworkSettings

PIECE = 64 * 1024
"""Bytes of one answer; a whole blob exceeds what one message may have on a narrow link."""
MAX_REPLY = 2 * PIECE  # bytes of an encoded reply
MAX_BLOB = 1024 * 1024
PULL_TIMEOUT = 20.0  # s for a whole blob, with the opening of the session
PIECE_TIMEOUT = 2.0  # s after which a piece is asked for again
# pulls a second
PULL_RATE = 1.0
PULL_BURST = 4.0
# pieces a second
SERVE_RATE = 64.0
SERVE_BURST = 64.0
MAX_ASKERS = 64
MAX_SERVING = 4  # pieces that are read from the disk at a time
DIGEST_BYTES = 32

Blob = bytes | None
Provider = Callable[[str, str], Blob]
"""Takes (name, asker), returns the blob of that name, or None. It is called in a thread.

In a secured swarm the link has proved the name of the asker.
"""


class PullQuery(Struct, frozen=True, kw_only=True):
    """Asks for `length` bytes of the blob `name` from `offset` on."""

    name: Word = ""
    offset: Count = 0
    length: Annotated[int, Meta(gt=0, le=PIECE)] = PIECE


class PullReply(Struct, frozen=True, kw_only=True):
    """A piece of a blob, or the reason of a refusal."""

    size: Count = 0  # bytes of the whole blob
    offset: Count = 0
    data: Annotated[bytes, Meta(max_length=PIECE)] = b""
    digest: Annotated[bytes, Meta(max_length=DIGEST_BYTES)] = b""  # SHA-256 of the whole blob
    text: Line = ""  # why there is no blob; empty otherwise


_query = Decoder(PullQuery)
_reply = Decoder(PullReply, MAX_REPLY)


# The side that asks


class Puller:
    """Pulls blobs for one daemon, one at a time. Use it on the loop.

    `asker`: the daemon's own name. `drops` counts pulls that fail by an unexpected error.
    """

    def __init__(
        self,
        settings: NetworkSettings,
        asker: str,
        identity: Identity | None = None,
        *,
        drops: DropCounter,
    ) -> None:
        self.settings = settings
        self._drops = drops
        self._identity = identity
        self._asker = asker
        self._rate = TokenBucket(PULL_RATE, PULL_BURST)
        self._task: asyncio.Task[None] | None = None

    def pull(
        self,
        peer: str,
        address: Address,
        what: str,
        name: str = "",
        *,
        limit: int = MAX_BLOB,
        digest: bytes | None = None,
        on_done: Callable[[Blob, str], object],
    ) -> bool:
        """Begin to pull a blob from a peer, in a task of the loop; False if no pull was begun.

        No pull is begun while another pull is under way, or beyond PULL_RATE: try again later.
        `what`: the kind of blob, such as a table of patterns. `name`: of a blob of this kind.
        `limit`: the most bytes. `digest`: the SHA-256 that the blob must have; None: the digest
        that the peer states. At the end the loop calls `on_done(blob, reason)`. If the pull failed,
        `blob` is None, and `reason` says why.
        """
        if self._task is not None or not self._rate.take(1.0, boottime()):
            return False

        def begin_pull() -> Awaitable[bytes]:
            return pull(  # the function of the module, which does the whole pull
                self.settings, peer, address, what, self._asker,
                name=name, limit=limit, digest=digest, identity=self._identity
            )  # fmt: skip

        run = self._run(begin_pull, peer, f"shared/{what}", on_done)
        self._task = asyncio.get_running_loop().create_task(run)
        return True

    async def _run(
        self,
        begin_pull: Callable[[], Awaitable[bytes]],
        peer: str,
        kind: str,
        on_done: Callable[[Blob, str], object],
    ) -> None:
        """Pull a blob, and call `on_done`; an unexpected error is logged and counted as `kind`."""
        # the reason of an unexpected error
        blob = None
        reason = FAILED
        with self._drops.refusing(kind):
            try:
                blob = await begin_pull()
            except (NetworkError, TimeoutError) as error:
                timeout_text = f"{peer} did not hand it over within {PULL_TIMEOUT:.0f} s"
                reason = str(error) or timeout_text
        self._task = None
        with self._drops.refusing(kind):
            on_done(blob, reason)

    def take_identity(self, identity: Identity) -> None:
        """Ask as this identity from now on."""
        self._identity = identity

    def close(self) -> None:
        """Cancel the pull under way; `on_done` is not called."""
        if self._task is not None:
            self._task.cancel()
            self._task = None


async def pull(
    settings: NetworkSettings,
    peer: str,
    address: Address,
    what: str,
    asker: str,
    *,
    name: str = "",
    limit: int = MAX_BLOB,
    digest: bytes | None = None,
    identity: Identity | None = None,
    timeout: float = PULL_TIMEOUT,
) -> bytes:
    """Pull the blob `name` of the kind `what` from `peer` at `address`, on a new Zenoh session.

    `asker`: the name of this robot or operator. `digest`: the SHA-256 that the blob must have;
    None: the digest that the peer states. Raises NetworkError in one line if the peer is not
    reached, lacks the blob, or sends more than `limit` bytes or bytes with another digest. Raises
    TimeoutError after `timeout` s.
    """
    key = build(settings.swarm, peer, SHARED, what, asker)
    async with asyncio.timeout(timeout):
        session = await open_in_thread(partial(open_pull_session, settings, address, identity))
        try:
            return await _pieces(session, key, f"{peer}: {what}", name, limit, digest)
        finally:  # to close a session may block, so a thread does this
            asyncio.get_running_loop().run_in_executor(None, _close, session)


async def _pieces(
    session: zenoh.Session, key: str, label: str, name: str, limit: int, digest: bytes | None
) -> bytes:
    content = bytearray()
    first = None
    while first is None or len(content) < first.size:
        reply = await _piece(session, key, PullQuery(name=name, offset=len(content)))
        if reply is None:
            continue  # the answer was lost, or the peer is busy; the caller bounds the time
        first = first or reply
        if reply.text:
            raise NetworkError(f"{label}: {reply.text}")
        if reply.size > limit:
            raise NetworkError(f"{label} has {reply.size} bytes; at most {limit} are taken")
        is_next = reply.offset == len(content) and (reply.data or not reply.size)
        if not is_next or (reply.size, reply.digest) != (first.size, first.digest):
            raise NetworkError(f"{label} changed while it was pulled")
        content += reply.data
    whole = bytes(content)
    present = hashlib.sha256(whole).digest()
    if present != (first.digest if digest is None else digest):
        raise NetworkError(f"{label} is damaged: its SHA-256 is {present.hex()[:12]}..")
    return whole


async def _piece(session: zenoh.Session, key: str, query: PullQuery) -> PullReply | None:
    """Query one piece of a blob; None without an answer within PIECE_TIMEOUT.

    Zenoh calls `on_reply` on its own thread, which hands the first reply to the loop. Raises
    NetworkError if the query cannot be sent, or the reply cannot be decoded.
    """
    loop = asyncio.get_running_loop()
    first_reply: asyncio.Future[bytes] = loop.create_future()

    def take(payload: bytes) -> None:
        if not first_reply.done():
            first_reply.set_result(payload)

    def on_reply(reply: zenoh.Reply) -> None:
        if reply.ok is not None and len(reply.ok.payload) <= MAX_REPLY:
            hand_over(loop, take, reply.ok.payload.to_bytes())

    try:
        session.get(
            key,
            zenoh.handlers.Callback(on_reply, indirect=False),  # on Zenoh's own thread
            congestion_control=zenoh.CongestionControl.DROP,
            timeout=PIECE_TIMEOUT,
            payload=encode(query),
        )
        return _reply(await asyncio.wait_for(first_reply, PIECE_TIMEOUT))
    except TimeoutError:
        return None
    except (zenoh.ZError, CodecError) as error:
        raise NetworkError(f"{key}: {error}") from error


def _close(session: zenoh.Session) -> None:
    with suppress(zenoh.ZError):
        session.close()


# The side that answers


def serve_shared(bus: ZenohBus, what: str, provider: Provider) -> None:
    """Serve blobs of the kind `what` to robots and operators, piece by piece.

    `provider(name, asker)` reads a blob, in a thread. A query is dropped without an answer if its
    asker exceeds SERVE_RATE, if another query of the asker is being served, or if MAX_SERVING
    queries are being served. The asker repeats the query.
    """
    loop = asyncio.get_running_loop()
    rates: dict[str, TokenBucket] = {}
    tasks: dict[asyncio.Task[None], str] = {}

    async def answer(query: Query) -> None:
        """Reply with a piece; an error drops the query."""
        with bus.drops.refusing(f"{SHARED}/{what}", lambda code, text: query.drop()):
            query.reply(await asyncio.to_thread(_answer, provider, query.payload, query.asker))

    def on_query(query: Query) -> None:
        asker = query.asker
        rate = rates.get(asker) or TokenBucket(SERVE_RATE, SERVE_BURST)
        keep_newest(rates, asker, rate, MAX_ASKERS)
        is_busy = len(tasks) >= MAX_SERVING or asker in tasks.values()
        if is_busy or not rate.take(1.0, boottime()):
            query.drop()
            return
        task = loop.create_task(answer(query))
        tasks[task] = asker
        task.add_done_callback(lambda done: tasks.pop(done, None))

    bus.serve(SHARED, what, on_query)


def _answer(provider: Provider, payload: bytes, asker: str) -> bytes:
    query = _query(payload)
    blob = provider(query.name, asker)
    if blob is None:
        return encode(PullReply(text="is not here"))
    if len(blob) > MAX_BLOB:
        return encode(PullReply(text=f"has {len(blob)} bytes; at most {MAX_BLOB} are sent"))
    end = query.offset + query.length
    data = blob[query.offset : end]
    digest = hashlib.sha256(blob).digest()
    return encode(PullReply(size=len(blob), offset=query.offset, data=data, digest=digest))
