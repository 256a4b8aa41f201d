"""The head of a recording, from which a replay can build the same robot."""

from __future__ import annotations

import base64
import hashlib
from collections.abc import Mapping
from typing import Any

import msgspec
import numpy as np
from msgspec import Struct

from swarmd.core.errors import ConfigError
from swarmd.core.values import Array
from swarmd.robot.setup import EarlierLives, RobotIdentity


class RecordingHead(Struct, frozen=True, kw_only=True):
    """The head of a recording: the robot, and all that decides its behaviour.

    - `clock`: the id of the robot's clock, see `core/clock.py`.
    - `machine`: the processor type, such as x86_64.
    - `libm`: `digest_of_libm` of the robot; empty if not known.
    - `identity`: whole, so that a new setting of robots is in recordings, too.
    - `earlier`: the state of the robot when the recording began.
    - `made`: `how_made` of the robot's process; empty if not known.
    """

    swarm: str
    clock: str
    machine: str
    identity: RobotIdentity
    earlier: EarlierLives = EarlierLives()
    libm: str = ""
    made: dict[str, str] = {}

    def texts(self) -> dict[str, str]:
        """The head as texts for a file: main fields in plain text, all fields in `head`."""
        payload = msgspec.msgpack.encode(self, enc_hook=_encoded)
        return {
            "robot": self.identity.robot,
            "swarm": self.swarm,
            "platform": self.identity.platform.name,
            "driver": self.identity.setup.driver,
            "clock": self.clock,
            "version": self.identity.setup.version,
            "head": base64.b64encode(payload).decode(),
        }


def head_of(about: Mapping[str, str], where: str) -> RecordingHead:
    """Decode the head in the texts of a file; ConfigError without a head of this version."""
    if "head" not in about:
        raise ConfigError(
            f"{where}: it is not a recording of swarmd; expected one, or play the scans and the"
            " odometry of any other with the driver replay"
        )
    try:
        payload = base64.b64decode(about["head"])
        return msgspec.msgpack.decode(payload, type=RecordingHead, dec_hook=_decoded)
    except (ValueError, RecursionError) as error:
        raise ConfigError(
            f"{where}: it does not tell its robot's settings ({error!r}); expected a recording of"
            " this version of swarmd"
        ) from error


def digest_of(value: object) -> str:
    """A digest in hex of a value that a head may have; equal values have one digest.

    Equal in each process: mappings and sets are put into an order first.
    """
    payload = msgspec.msgpack.encode(value, enc_hook=_encoded, order="deterministic")
    return hashlib.sha256(payload).hexdigest()[:16]


def _encoded(value: Any) -> Any:
    if isinstance(value, np.ndarray):
        return value.tolist()
    if isinstance(value, Mapping):
        return dict(value)
    raise TypeError(f"{type(value).__name__} is no type of MessagePack")


def _decoded(kind: Any, value: Any) -> Array:
    return np.array(value, dtype=np.float64)
