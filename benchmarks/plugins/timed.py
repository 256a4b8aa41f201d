"""Attraction that reports when its host got the frame of a step and when it had the answer."""

from __future__ import annotations

import sys
from collections.abc import Callable, Mapping
from time import monotonic_ns
from typing import Any

from swarmd.api import Context, Scalar
from swarmd.core.host_messages import Step, Stepped
from swarmd.patterns.attraction.pattern import Attraction, AttractionParams


class Timed(Attraction):
    """Reports the stamps (ns, CLOCK_MONOTONIC) of the step before, with its scan's `seq`."""

    def __init__(self, params: AttractionParams, context: Context) -> None:
        """Stamp at the host's borders: first after its recv, last before its send."""
        super().__init__(params, context)
        self._stamps: dict[str, int] = {}
        self._came = 0
        host = sys.modules.get("swarmd.pattern_host.worker")
        if host is not None:
            setattr(host, "decode_command", self._on_frame(host.decode_command))  # noqa: B010
            setattr(host, "encode_event", self._on_answer(host.encode_event))  # noqa: B010

    def report(self) -> Mapping[str, Scalar]:
        """The stamps, besides what attraction says."""
        return {**super().report(), **self._stamps}

    def _on_frame(self, decode: Callable[[bytes], Any]) -> Callable[[bytes], Any]:
        def decode_stamped(frame: bytes) -> Any:
            came = monotonic_ns()
            command = decode(frame)
            if isinstance(command, Step):
                self._came = came
            return command

        return decode_stamped

    def _on_answer(self, encode: Callable[[Any], bytes]) -> Callable[[Any], bytes]:
        def encode_stamped(event: Any) -> bytes:
            answer = encode(event)
            if isinstance(event, Stepped):
                self._stamps = {"seq": event.scan_seq, "came": self._came, "went": monotonic_ns()}
            return answer

        return encode_stamped
