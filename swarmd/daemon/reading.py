"""Reads what operators ask: strictly, but a stop by no more than that it is one, and for whom."""

from __future__ import annotations

from swarmd.core.codec import Decoder
from swarmd.core.errors import CodecError
from swarmd.core.messages import Halt, Request

HALTS = frozenset({"stop", "estop"})
ID = 63
OPERATOR = 128


class RequestReader:
    """From the payload on a verb's key to a request for that verb."""

    def __init__(self) -> None:
        self._request = Decoder(Request)
        self._halt = Decoder(Halt)

    def __call__(self, verb: str, payload: bytes) -> Request:
        """The request; CodecError if it is none, of another verb, or names nobody but must."""
        try:
            request = self._request(payload)
        except CodecError:
            if verb not in HALTS:
                raise
            request = self._read_halt(payload)
        if request.verb != verb:
            raise CodecError(f"a request to {request.verb} came on the key of {verb}")
        if request.targets is None and verb not in HALTS:
            raise CodecError(f"{verb} must name its targets")
        return request

    def _read_halt(self, payload: bytes) -> Request:
        halt = self._halt(payload)
        return Request(
            id=halt.id[:ID] or "unnamed",
            operator=halt.operator[:OPERATOR] or "unknown",
            verb=halt.verb,
            targets=None if halt.targets is None else dict.fromkeys(halt.targets),
        )
