"""What happened in a run, in few words for pictures over time."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from swarmd.sim.trace import Trace

MOST_EVENTS = 12
_TOO_CLOSE = 0.025  # of the duration: events that would be written over each other


def events_of(trace: Trace) -> tuple[tuple[float, str], ...]:
    """Time in s and words of what happened after the start; nothing if it is too much to tell."""
    found: list[tuple[float, list[str]]] = []
    for event in trace.meta.get("events", ()):
        at, word = float(event["at"]), _word(event, len(trace.ids))
        if at <= 0.0:
            continue
        if found and at - found[-1][0] < _TOO_CLOSE * trace.duration:
            if word not in found[-1][1]:
                found[-1][1].append(word)
        else:
            found.append((at, [word]))
    if len(found) > MOST_EVENTS:
        return ()
    return tuple((at, ", ".join(words)) for at, words in found)


def _word(event: Mapping[str, Any], n: int) -> str:
    robots = event.get("robots") or ()
    who = f"{len(robots)} robots" if len(robots) > 1 else "".join(robots)
    words = [event["action"], event.get("pattern") or "", "" if len(robots) == n else who]
    return " ".join(word for word in words if word)
