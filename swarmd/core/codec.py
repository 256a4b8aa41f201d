"""Bytes on the wire: one version byte, then MessagePack, within a size limit.

Of a payload of another version, this program reads only the fields of the `..Header` structs of
messages.py, which are the same in all versions.

Bytes from the network are decoded into typed structs, whose bounds also refuse NaN and infinity.
Decoding raises nothing but `CodecError`. This module imports no numpy, since swarmctl imports this
module.
"""

from __future__ import annotations

from functools import cache, cached_property
from typing import Any, Generic, TypeVar

import msgspec

from swarmd.core.errors import CodecError

VERSION = 1
MAX_CONTROL = 64 * 1024
MAX_SENSOR_PAYLOAD = 128 * 1024
MAX_MESSAGE = 1024
MAX_DEPTH = 16

_NESTED = (dict, list, tuple)
_PLAIN = frozenset({type(None), bool, int, float, str, bytes})
_encoder = msgspec.msgpack.Encoder()

T = TypeVar("T")


def encode(message: msgspec.Struct) -> bytes:
    """The bytes of a struct."""
    return _prefix() + _encoder.encode(message)


def as_json(payload: bytes) -> bytes:
    """The bytes of an encoded struct as JSON, for programs without MessagePack; bytes in base64."""
    return msgspec.json.encode(msgspec.msgpack.decode(payload[1:]))


def version_of(payload: bytes) -> int | None:
    """The version byte of a payload; None for an empty payload."""
    return payload[0] if payload else None


def decode(decoder: msgspec.msgpack.Decoder[T], content: bytes | memoryview, what: str) -> T:
    """The value of bytes without a version. CodecError, which names `what`, if malformed."""
    try:
        return decoder.decode(content)
    except (msgspec.MsgspecError, RecursionError, UnicodeDecodeError) as error:
        raise CodecError(f"{what} that cannot be read: {error}") from error


class Decoder(Generic[T]):
    """Decodes one type of struct. To make a decoder is slow: make one for each type.

    msgspec's decoder is made at the first payload: that of a `Status` takes 2.5 ms, and most
    commands read none. `any_version`: for a stable subset, which is read from payloads of every
    version.
    """

    def __init__(
        self, kind: type[T], limit: int = MAX_CONTROL, *, any_version: bool = False
    ) -> None:
        self._kind = kind
        self._limit = limit
        self._any_version = any_version

    @cached_property
    def _decoder(self) -> msgspec.msgpack.Decoder[T]:
        return msgspec.msgpack.Decoder(self._kind)

    def __call__(self, payload: bytes) -> T:
        """Decode a struct. Raises CodecError if it is too large, of another version or type."""
        body = _body(payload, self._limit, any_version=self._any_version)
        return decode(self._decoder, body, "a payload")


def encode_value(value: Any) -> bytes:
    """Encode a pattern's message. Raises CodecError if it cannot be sent."""
    try:
        payload: bytes = _prefix() + _msgpack().packb(value, use_bin_type=True)
    except (TypeError, ValueError, OverflowError, RecursionError) as error:
        raise CodecError(f"a message must be made of MessagePack's types: {error}") from error
    if _is_deeper(value, MAX_DEPTH):
        raise CodecError(f"a message nests deeper than {MAX_DEPTH}")
    if len(payload) > MAX_MESSAGE:
        raise CodecError(f"a message is {len(payload)} bytes; at most {MAX_MESSAGE} are sent")
    return payload


def decode_value(payload: bytes) -> Any:
    """Decode a pattern's message. Raises CodecError if it is too large or malformed."""
    body = _body(payload, MAX_MESSAGE)
    msgpack = _msgpack()
    try:
        value = msgpack.unpackb(body, raw=False, strict_map_key=True)
    except (ValueError, TypeError, RecursionError, msgpack.UnpackException) as error:
        raise CodecError(f"not MessagePack: {error!r}") from error
    if _is_deeper(value, MAX_DEPTH):
        raise CodecError(f"a message nests deeper than {MAX_DEPTH}")
    if not _is_plain(value):
        raise CodecError("a message has an extension type")
    return value


def _is_plain(value: Any) -> bool:
    """True without extension types (timestamps among them), which no pattern host can receive."""
    if type(value) in _PLAIN:
        return True
    if isinstance(value, dict):
        value = value.values()
    elif not isinstance(value, list):
        return False
    return all(type(inner) in _PLAIN or _is_plain(inner) for inner in value)


def _is_deeper(value: Any, depth: int) -> bool:
    if isinstance(value, dict):
        value = value.values()
    elif not isinstance(value, _NESTED):
        return False
    return depth == 0 or any(
        isinstance(inner, _NESTED) and _is_deeper(inner, depth - 1) for inner in value
    )


@cache
def _msgpack() -> Any:
    import msgpack  # swarmctl does without; importing it takes 2 ms

    return msgpack


def _prefix() -> bytes:
    return bytes((VERSION,))


def _body(payload: bytes, limit: int, *, any_version: bool = False) -> memoryview:
    if len(payload) > limit:
        raise CodecError(f"{len(payload)} bytes; at most {limit} are read")
    version = version_of(payload)
    if version is None or (version != VERSION and not any_version):
        raise CodecError(f"wire version {payload[:1].hex() or 'none'}; this is version {VERSION}")
    return memoryview(payload)[1:]
