"""Frames between the daemon and its pattern host: one MessagePack record in each frame.

A record is a tagged struct of `swarmd.core.host_messages`, encoded as an array; numpy arrays are
encoded as bytes. The daemon does not trust its host: it decodes events into typed, bounded structs.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

import msgspec
import numpy as np

from swarmd.core.errors import CodecError
from swarmd.core.host_messages import Loaded, SentCommand, SentEvent, Stepped
from swarmd.core.messages import Sandbox
from swarmd.core.values import Array, TouchZone, Twist

MAX_FRAME = 200_000
"""Bytes. A record above about 212 kB does not fit into the socket's buffer."""

MAX_NUMBER = 1e6
"""rad, m/s and rad/s: a command or touch zone with more is garbage."""


def _encode_array(value: Any) -> Any:
    if isinstance(value, np.ndarray):
        return value.tobytes() if value.ndim == 1 else value.tolist()
    return _encode_plain(value)


def _encode_plain(value: Any) -> Any:
    if isinstance(value, np.generic):
        return value.item()
    if isinstance(value, Mapping):
        return dict(value)
    raise TypeError(f"{type(value).__name__} is no type of MessagePack")


def _decode_array(kind: Any, value: Any) -> Array:
    if isinstance(value, bytes):
        return np.frombuffer(value, dtype=np.float64)  # read-only, as for patterns that run inline
    array = np.array(value, dtype=np.float64)
    array.flags.writeable = False
    return array


_command_encoder = msgspec.msgpack.Encoder(enc_hook=_encode_array)
_event_encoder = msgspec.msgpack.Encoder(enc_hook=_encode_plain)
_events: msgspec.msgpack.Decoder[SentEvent] = msgspec.msgpack.Decoder(SentEvent)
_sandboxes: msgspec.msgpack.Decoder[Sandbox] = msgspec.msgpack.Decoder(Sandbox)

decode_command: Callable[[bytes], SentCommand] = msgspec.msgpack.Decoder(
    SentCommand, dec_hook=_decode_array
).decode
"""Decode a frame of the daemon."""


def encode_command(command: SentCommand) -> bytes:
    """The frame of a command. Raises CodecError if it is too big or cannot be encoded."""
    return _encoded(_command_encoder, command)


def encode_event(event: SentEvent) -> bytes:
    """The frame of an event. Raises CodecError if it is too big or cannot be encoded."""
    return _encoded(_event_encoder, event)


def decode_event(frame: bytes) -> SentEvent:
    """Decode a frame of the host; CodecError if it is malformed or a number is out of bounds."""
    try:
        event = _events.decode(frame)
    except (msgspec.MsgspecError, RecursionError, UnicodeDecodeError) as error:
        raise CodecError(f"the pattern host sent an unreadable frame: {error}") from error
    if isinstance(event, Stepped) and event.outputs.twist is not None:
        _check_bounds(event.outputs.twist)
    elif isinstance(event, Loaded) and event.touches is not None:
        _check_bounds(event.touches)
    return event


def decode_sandbox(frame: bytes) -> Sandbox:
    """Decode the first frame of a host."""
    try:
        return _sandboxes.decode(frame)
    except (msgspec.MsgspecError, UnicodeDecodeError) as error:
        return Sandbox(missing=f"the host sent an unreadable frame: {error}"[:300])


def _encoded(encoder: msgspec.msgpack.Encoder, record: SentCommand | SentEvent) -> bytes:
    what = type(record).__name__
    try:
        frame = encoder.encode(record)
    except (TypeError, ValueError, OverflowError, RecursionError) as error:
        raise CodecError(f"{what} cannot be encoded as MessagePack: {error}") from error
    if len(frame) > MAX_FRAME:
        raise CodecError(f"{what} has {len(frame)} bytes; at most {MAX_FRAME} fit")
    return frame


def _check_bounds(value: Twist | TouchZone) -> None:
    for number in msgspec.structs.astuple(value):
        if not -MAX_NUMBER <= number <= MAX_NUMBER:  # NaN fails too
            raise CodecError(f"the pattern host sent an impossible value: {value}")
