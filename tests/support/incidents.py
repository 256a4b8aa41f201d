"""Files of incidents, made by hand from recorded stories."""

from __future__ import annotations

from pathlib import Path

import msgspec

from swarmd.core.incident import Incident, IncidentKind
from swarmd.daemon.recording import frames
from swarmd.daemon.recording.incident_file import SUFFIX, IncidentHead, pack
from swarmd.daemon.recording.ring import Ring, entries_of
from tests.support.recorded_stories import Story, head_at

ID = "0123456789ab"
WALL = 1.7e9  # s since 1970 at the begin of the ring
PER_FRAME = 40


def incident_of(robot: str, text: str = "a chair fell") -> Incident:
    return Incident(id=ID, robot=robot, kind=IncidentKind.MARK, text=text, by=robot, wall=WALL)


def keep(story: Story, folder: Path, before: float = 1.0, incident: Incident | None = None) -> Path:
    """The file that the robot of a story keeps of an incident `before` s before its end."""
    robot = story.robot.robot.id
    incident = incident or incident_of(robot)
    found = frames.decode_batch(frames.batch(story.recorder.entries))
    begin = next(n for n, one in enumerate(found) if isinstance(one, frames.MemoryEntry))
    start, at = found[begin].at, story.robot.now - before
    told = frames.TextEntry(at, "/incident", msgspec.json.encode(incident))
    behind = next((n for n, one in enumerate(found) if one.at > at), len(found))
    entries = [*found[begin:behind], told, *found[behind:]]
    folder.mkdir(parents=True, exist_ok=True)
    about = head_at(story.robot).texts()
    ring = Ring(folder / "ring", about, capacity=1 << 22, seconds=60.0, boot=start, wall=WALL)
    ring.begin_segment(start)
    for first in range(0, len(entries), PER_FRAME):
        part = entries[first : first + PER_FRAME]
        ring.write(frames.batch([frames.encode(one) for one in part]))
    left = ring.left()
    ring.close()
    assert len(entries_of(left)) == len(entries)
    head = IncidentHead(
        incident=incident, at=at, clock="c", begin=start, end=found[-1].at,
        size=len(left.frames), about=left.about, boot=left.boot, wall=left.wall,
    )  # fmt: skip
    path = folder / f"{incident.id}{SUFFIX}"
    path.write_bytes(pack(head, left.frames))
    return path
