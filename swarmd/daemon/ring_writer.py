"""Writes the ring of the black box: the entries of each tick, and the memory of the robot at times.

The ring gets the entries of a tick at its end, after the command has gone to the base. So a daemon
that is killed loses the entries of one tick, and no command is later than without the ring.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable

from swarmd.daemon.recording import frames
from swarmd.daemon.recording.ring import Ring

SEGMENT_TIME = 30.0
"""Seconds after which a segment of the ring is followed by another one."""
FIRST_COST = 0.01
"""Seconds that a memory is expected to take before one was taken."""
COSTS = 3  # memories whose shortest time counts
HEADROOM = 1.5
"""The time left for a memory, to the time that the last one took."""


class MemoryCost:
    """How long a memory of the robot takes. A busy machine makes some memories slow."""

    def __init__(self) -> None:
        self._last = deque([FIRST_COST], maxlen=COSTS)  # s

    def note(self, seconds: float) -> None:
        """Note what a memory took."""
        self._last.append(seconds)

    def fits(self, time_left: float) -> bool:
        """True if `time_left` s are enough for a memory."""
        return time_left >= HEADROOM * min(self._last)


class RingWriter:
    """Hands entries to a ring, while there is one. `on_event` takes a line for the robot's log.

    `fault`: why the ring ended by itself.
    """

    def __init__(self, on_event: Callable[[str], None]) -> None:
        self._on_event = on_event
        self.ring: Ring | None = None
        self.fault = ""
        self.memory_cost = MemoryCost()
        self._entries: list[bytes] = []  # encoded
        self._segment_at = -math.inf  # s; the begin of the present segment

    def put(self, encoded: bytes) -> None:
        """Add an encoded entry to the next write; ignored without a ring."""
        if self.ring is not None:
            self._entries.append(encoded)

    def write(self) -> None:
        """Write the entries so far to the ring."""
        entries = self._entries
        self._entries = []
        if self.ring is None or not entries:
            return
        try:
            self.ring.write(frames.batch(entries[-frames.MAX_BATCH :]))
        except OSError as error:
            self.end(error.strerror or str(error))

    def end(self, fault: str) -> None:
        """End the black box, and say why."""
        if self.ring is not None:  # its file would tell the next daemon of a crash
            self.ring.close(keeps_file=False)
        self.ring = None
        self.fault = f"off: {fault}"
        self._on_event(f"black box ends: {fault}")

    def is_segment_due(self, now: float, time_left: float) -> bool:
        """True if the ring must get a memory of the robot, and begin a segment, at `now` s.

        `time_left`: s until the next input that may change the command; 0: a scan may come at any
        time. The memory waits for time enough, for SEGMENT_TIME at most.
        """
        if self.ring is None or not time_left:
            return False
        age = now - self._segment_at
        if age < SEGMENT_TIME and not self.ring.is_long:
            return False
        return self.memory_cost.fits(time_left) or age >= 2.0 * SEGMENT_TIME

    def begin_segment(self, memory: bytes, now: float, *, boot: float, wall: float) -> None:
        """Begin a segment with the memory of the robot at `now` s; there must be a ring.

        `boot`, `wall`: s by the clock of the robot and by the wall clock, at one instant.
        """
        ring = self.ring
        assert ring is not None
        ring.begin_segment(now)
        ring.set_clock(boot, wall)  # a robot without a battery clock starts in 1970
        self._segment_at = now
        self.put(frames.encode(frames.MemoryEntry(now, memory)))
        self.write()

    def postpone_segment(self, now: float) -> None:
        """Begin no segment for SEGMENT_TIME, since the memory could not be taken."""
        self._segment_at = now
