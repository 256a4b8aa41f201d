"""Bounded types for fields that come from the network or from files, and a bounded table.

Every float is bounded, since bounds also refuse NaN and infinity.
"""

from __future__ import annotations

from typing import Annotated, TypeVar

from msgspec import Meta

MAX_COORDINATE = 1e9
"""m, rad, m/s and rad/s: a reading of odometry beyond is garbage, and has no difference either."""
MAX_SECONDS = 1e9
Seconds = Annotated[float, Meta(ge=0.0, le=MAX_SECONDS)]
Speed = Annotated[float, Meta(ge=-100.0, le=100.0)]
Count = Annotated[int, Meta(ge=0, le=2**53)]
Rate = Annotated[float, Meta(ge=0.0, le=1e6)]
Metres = Annotated[float, Meta(ge=-1e6, le=1e6)]
Angle = Annotated[float, Meta(ge=-100.0, le=100.0)]
Stamp = Annotated[float, Meta(ge=-1e10, le=1e10)]
"""Seconds on the sensor's clock: a real one counts from 1970."""
Coordinate = Annotated[float, Meta(ge=-1e9, le=1e9)]
"""Metres in the odometry frame, which may be that of a map."""
Step = Annotated[float, Meta(ge=-10.0, le=10.0)]
"""Seconds from one ray to the next."""
Height = Annotated[float, Meta(ge=0.0, le=100.0)]
Name = Annotated[str, Meta(min_length=1, max_length=63)]
Id = Annotated[str, Meta(pattern=r"^[a-z0-9][a-z0-9_-]{0,62}\Z")]
IncidentId = Annotated[str, Meta(pattern=r"^[0-9a-f]{12}\Z")]
"""It names files, so it is no name of a robot."""
Word = Annotated[str, Meta(max_length=64)]
Line = Annotated[str, Meta(max_length=1000)]
FileName = Annotated[
    str,
    Meta(
        pattern=r"^[^./\\\x00-\x1f\x7f\ud800-\udfff][^/\\\x00-\x1f\x7f\ud800-\udfff]*\Z",
        max_length=200,
    ),
]
"""The name of a file in a known folder: no path, no hidden file, no control character."""
MAX_REASON = 256  # characters
ReasonText = Annotated[str, Meta(max_length=MAX_REASON)]
BoundedScalar = (
    bool
    | Annotated[int, Meta(ge=-(2**53), le=2**53)]
    | Annotated[float, Meta(ge=-1e300, le=1e300)]
    | Annotated[str, Meta(max_length=256)]
)
ParamValues = dict[Word, BoundedScalar | None]

K = TypeVar("K")
V = TypeVar("V")


def keep_newest(table: dict[K, V], key: K, value: V, limit: int) -> None:
    """Set an entry as the newest entry of `table`; drop the oldest entries beyond `limit`."""
    table.pop(key, None)
    table[key] = value
    while len(table) > limit:
        del table[next(iter(table))]
