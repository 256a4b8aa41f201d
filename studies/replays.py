"""Are live recordings of crowds repeated to the bit, by robots with clocks of any uptime?

`python -m studies.replays [--runs 20] [--seconds 40]` records crowds of four to seven Waffle Pis on
a loaded machine: two processes compute beside. The clocks of a run begin at one minute, ten minutes
or one day of uptime, by an offset of the kernel (time_namespaces(7)), which needs the program
`unshare` and user namespaces. Each run has starts, stops, an emergency stop and its reset, changes
of patterns and parameters, avoidance, a fence, and a pattern host that is killed. Each recording is
then repeated in this process, whose clock has no offset. Prints a row for each run; the exit code
is 1 if one command differs.
"""

from __future__ import annotations

import argparse
import contextlib
import json
import os
import signal
import subprocess
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

from benchmarks.swarm import Swarm
from studies.safety.live import busy
from swarmd.core.clock import boottime
from swarmd.core.verbs import EstopRequest, ParamRequest, ResetRequest, RunRequest, StopRequest
from swarmd.plugins import pattern_names, places_of
from swarmd.recording import messages
from swarmd.recording.reader import RecordedFile, read_file
from swarmd.replay.replay import Parity, prepare, recordings_of, total
from swarmd.replay.swarm import repeat_together
from swarmd.settings.yamlfile import text_of

UPTIMES = (60.0, 600.0, 86_400.0)
BUSY = 2
_WALK = {"clearance": 0.0, "straight_min": 3.0, "straight_max": 8.0}  # only protection looks


class RecordedSwarm(Swarm):
    """A swarm inside a fence, whose daemons record from their start to `recordings`."""

    def __init__(self, count: int, seed: int, recordings: Path) -> None:
        side = 1.3 * count**0.5 + 0.8
        half = 0.5 * side - 0.25
        platform = recordings / "fenced.yaml"
        provides = ["scan", "odometry", "pose"]
        platform.write_text(text_of({"extends": "waffle_pi", "provides": provides}))
        world = {"seed": seed, "arena": f"{side:.2f}x{side:.2f}", "shared_frame": True}
        super().__init__(count, str(platform), world=world)
        self.recordings = recordings
        corners = [[-half, -half], [half, -half], [half, half], [-half, half]]
        self._more = {"fence": {"frame": "world", "polygon": corners}}

    def _daemon_command(self, robot: str) -> list[str]:
        command = super()._daemon_command(robot)
        recording = {"from_start": True, "folder": str(self.recordings / robot)}
        with (self.folder / f"{robot}.yaml").open("a") as file:
            file.write(text_of({"recording": recording, **self._more}))
        return command

    def ask(self, verb: Any, robots: Sequence[str], **words: Any) -> None:
        """Request something of robots; a refusal is part of the recording."""
        self.operator.request(verb, self.operator.members().epochs(robots), **words)

    def kill_host(self, robot: str) -> None:
        """Kill the process in which the pattern of a robot runs."""
        own = str(self.daemons[robot].pid)
        for status in Path("/proc").glob("[0-9]*/status"):
            with contextlib.suppress(OSError):
                text = status.read_text()
                if text.startswith("Name:\tswarmd-host\n") and f"\nPPid:\t{own}\n" in text:
                    os.kill(int(status.parent.name), signal.SIGKILL)


def record(count: int, seed: int, seconds: float, folder: Path) -> None:
    """Record a crowd through its whole story, `seconds` long."""
    pause = seconds / 10.0
    with RecordedSwarm(count, seed, folder) as swarm:
        first, second, third, *_ = swarm.robots
        story: tuple[Callable[[], None], ...] = (
            lambda: swarm.ask(RunRequest, swarm.robots, pattern="random_walk", params=_WALK),
            lambda: swarm.ask(StopRequest, [first]),
            lambda: swarm.ask(RunRequest, [first], pattern="random_walk", params=_WALK),
            lambda: swarm.ask(EstopRequest, [second], reason="a chair"),
            lambda: swarm.ask(ResetRequest, [second], ids=_latches(swarm, second)),
            lambda: swarm.ask(RunRequest, [second], pattern="levy_walk"),
            lambda: swarm.kill_host(third),
            lambda: swarm.ask(ParamRequest, [first], params={"clearance": 0.2}),
            lambda: swarm.ask(
                RunRequest, swarm.robots, pattern="attraction", params={"recovery": True}
            ),
            lambda: swarm.ask(StopRequest, swarm.robots),
        )
        for part in story:
            part()
            time.sleep(pause)
        swarm.close()


def _latches(swarm: Swarm, robot: str) -> tuple[str, ...]:
    return tuple(swarm.statuses()[robot].latches)


def record_at(uptime: float, count: int, seed: int, seconds: float, folder: Path) -> None:
    """Record a crowd, in processes whose clocks begin at `uptime` s, while others compute."""
    offset = round(uptime - boottime())
    words = ("--user", "--map-root-user", "--time", "--boottime", str(offset), "--fork")
    run = json.dumps([count, seed, seconds, str(folder)])
    command = ["unshare", *words, sys.executable, "-m", __spec__.name, "--record", run]
    with busy(BUSY):
        subprocess.run(command, check=True, cwd=Path(__file__).parents[1])


def repeated(folder: Path) -> Mapping[str, Parity]:
    """The comparison of each robot's recordings in a folder, by robot."""
    origins = places_of(pattern_names(None))
    found = {}
    for robot in sorted(path for path in folder.iterdir() if path.is_dir()):
        recordings = recordings_of(map(read_file, sorted(robot.glob("*.mcap"))))
        lives = [prepare(files, origins) for files in recordings]
        repeat_together(lives)
        found[robot.name] = total(life.parity() for life in lives)
    return found


def content(files: Sequence[RecordedFile]) -> Counter[str]:
    """What happened in recordings: decisions, and those of each kind."""
    found: Counter[str] = Counter()
    for message in (one for file in files for one in file.messages):
        if message.topic == "/decision":
            decision = messages.deserialize(message.kind, message.payload)
            found["decisions"] += 1
            found["active"] += bool(decision.is_active)
            found["avoids"] += bool(decision.avoiding)
            found[f"in {decision.state}"] += 1
        elif message.topic == "/event":
            found["hosts that ended"] += b"its process" in message.payload
    return found


def main() -> None:
    """Record and repeat; or record one crowd, for the process with another clock."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--runs", type=int, default=20)
    parser.add_argument("--seconds", type=float, default=40.0)
    parser.add_argument("--keep", type=Path, help="a folder in which the recordings stay")
    parser.add_argument("--record", help=argparse.SUPPRESS)
    given = parser.parse_args()
    if given.record:
        count, seed, seconds, folder = json.loads(given.record)
        record(count, seed, seconds, Path(folder))
        return
    with tempfile.TemporaryDirectory() as temporary:
        folder = given.keep or Path(temporary)
        is_equal = [_row(number, given.seconds, folder) for number in range(given.runs)]
    print(f"{sum(is_equal)} of {len(is_equal)} crowds are repeated to the bit")
    sys.exit(not all(is_equal))


def _row(number: int, seconds: float, kept: Path) -> bool:
    """Record and repeat one crowd, print its row; True if all commands are equal."""
    folder = kept / f"crowd-{number:02d}"
    folder.mkdir()
    count, uptime = 4 + number % 4, UPTIMES[number % len(UPTIMES)]
    record_at(uptime, count, number, seconds, folder)
    found = repeated(folder)
    files = [read_file(path) for path in sorted(folder.glob("*/*.mcap"))]
    parity = total(found.values())
    print(f"crowd {number}: {count} robots, uptime {uptime:.0f} s, {dict(content(files))}")
    for robot, one in found.items():
        if not (one.safe.is_equal and one.requested.is_equal) or one.notes:
            print(f"  {robot}: {one.safe}, {one.requested}, {one.notes}")
    print(f"  safe {parity.safe.equal} of {parity.safe.count} equal,", end=" ")
    print(f"requested {parity.requested.equal} of {parity.requested.count}", flush=True)
    return parity.safe.is_equal and parity.requested.is_equal


if __name__ == "__main__":
    main()
