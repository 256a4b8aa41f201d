"""Network load of N robots: packets, bytes, CPU and memory, idle, voting at 2 Hz or chat at 10 Hz.

Each robot is a daemon with a fake body in a network namespace of its own. The namespaces are
connected by a bridge of the kernel, and the interface of a robot counts the packets that it sends.
Zenoh programs (`--programs 0 1 4`) share one more namespace; each is linked to all robots, and
sends on the channel of the load twice a second. Needs root. Group packets are multicast and
broadcast packets (IPv4). All other packets are unicast. Bytes are those of Ethernet frames without
preamble and checksum.

Air time is that of one Wi-Fi channel with one access point, which every frame passes twice. A frame
to or from a station takes `SMALL_FRAME` (`AGGREGATED_FRAME` if frames are aggregated). A frame from
the access point to a group takes `GROUP_OVERHEAD` and the time of its bits at 6 Mbit/s. The second
table fits each quantity by a constant and a term per peer, and extrapolates.
"""

from __future__ import annotations

import argparse
import contextlib
import json
import os
import statistics
import sys
import tempfile
import time
from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np

from benchmarks.resources import cpu_seconds, memory
from benchmarks.swarm import PLUGINS
from benchmarks.table import markdown
from tests.support.field import Field, lacks
from tests.support.field_swarm import FieldSwarm, Lines
from tests.support.processes import children, wait_until

LOADS: dict[str, tuple[str, ...]] = {
    "idle": (),
    "voting": ("majority_rule", "-p", "share_period=0.5"),
    "chat": ("chat",),
}
CHANNELS = {"idle": (), "voting": ("majority_rule/opinion", "1"), "chat": ("chat/text", '"x"')}
"""The channel and the JSON value that programs send, by load."""
ETHERNET = 14  # bytes of a frame's header
READY_TIMEOUT = 180.0
SMALL_FRAME, AGGREGATED_FRAME, GROUP_OVERHEAD = 200e-6, 60e-6, 100e-6  # s of air time
GROUP_RATE = 6e6  # bit/s
PROGRAM = "benchmarks.zenoh_program"
LARGE = (100, 300)  # robots


@dataclass(frozen=True, slots=True)
class Counters:
    """Packets and bytes that a robot has sent, and CPU seconds of its daemon and pattern host."""

    packets: int
    size: int
    group_packets: int
    group_size: int
    daemon_cpu: float
    host_cpu: float


@dataclass(frozen=True, slots=True)
class Measured:
    """Means over the robots: packets and bytes per second that a robot sends, % of a core, MB.

    `program_packets` and `program_size`: the totals of all programs.
    """

    robots: int
    load: str
    programs: int
    program_packets: float
    program_size: float
    packets: float
    size: float
    group_packets: float
    group_size: float
    daemon_cpu: float
    host_cpu: float
    daemon_rss: float
    host_rss: float
    machine_load: float

    @property
    def cells(self) -> tuple[str, ...]:
        """The texts of the columns of `HEAD`."""
        pairs = max(1, self.robots - 1)
        unicast = self.packets - self.group_packets
        packets = self.robots * self.packets + self.program_packets
        size = self.robots * self.size + self.program_size
        return (
            *(str(self.robots), self.load, str(self.programs)),
            *(f"{self.packets:.1f}", f"{self.size:.0f}"),
            *(f"{self.group_packets:.2f}", f"{self.group_size:.0f}", f"{unicast:.1f}"),
            *(f"{self.packets / pairs:.2f}", f"{self.size / pairs:.0f}"),
            f"{packets:.0f}",
            f"{size * 8e-6:.3f}",
            *(f"{self.daemon_cpu:.2f}", f"{self.host_cpu:.2f}"),
            *(f"{self.daemon_rss:.0f}", f"{self.host_rss:.0f}", f"{self.machine_load:.0f}"),
        )


def air_time(robots: float, unicast: float, group: float, group_size: float, frame: float) -> float:
    """The air time of robots, in % of a channel.

    Each robot sends `unicast` and `group` frames and `group_size` group bytes per second. `frame`:
    s of air time of one frame.
    """
    to_group = group * (frame + GROUP_OVERHEAD) + 8.0 * group_size / GROUP_RATE
    return 100.0 * robots * (2.0 * unicast * frame + to_group)


LAW_HEAD = ("load", "a robot", "alone", "a peer", *(f"at {robots} robots" for robots in LARGE))


def laws(rows: Sequence[Measured]) -> Iterator[tuple[str, ...]]:
    """Rows of the second table: the law of each quantity, and the air time at `LARGE`."""
    for load in LOADS:
        some = [row for row in rows if row.load == load and not row.programs]
        if len({row.robots for row in some}) < 2:
            continue

        def fitted(values: Sequence[float], some: Sequence[Measured] = some) -> tuple[float, float]:
            slope, alone = np.polyfit([row.robots - 1.0 for row in some], values, 1)
            return float(alone), float(slope)

        quantities = {
            "unicast packets/s": fitted([row.packets - row.group_packets for row in some]),
            "group packets/s": fitted([row.group_packets for row in some]),
            "bytes/s": fitted([row.size for row in some]),
            "group bytes/s": fitted([row.group_size for row in some]),
            "CPU daemon %": fitted([row.daemon_cpu for row in some]),
            "RSS daemon MB": fitted([row.daemon_rss for row in some]),
        }
        at = {
            name: [alone + slope * (robots - 1) for robots in LARGE]
            for name, (alone, slope) in quantities.items()
        }
        for name, (alone, slope) in quantities.items():
            yield (load, name, f"{alone:.3g}", f"{slope:.3g}", *(f"{row:.3g}" for row in at[name]))
        for frame in (SMALL_FRAME, AGGREGATED_FRAME):
            shares = []
            for number, robots in enumerate(LARGE):
                unicast, group = at["unicast packets/s"][number], at["group packets/s"][number]
                taken = air_time(robots, unicast, group, at["group bytes/s"][number], frame)
                shares.append(f"{taken:.3g} %")
            yield (load, f"air time at {1e6 * frame:.0f} us a frame", "", "", *shares)


HEAD = (
    *("robots", "load", "programs", "packets/s a robot", "bytes/s"),
    *("group packets/s", "group bytes/s"),
    *("unicast packets/s", "packets/s a pair", "bytes/s a pair", "packets/s in all"),
    *("Mbit/s in all", "CPU daemon %", "CPU host %", "RSS daemon MB", "RSS host MB"),
    "load average",
)


def sent(pid: int) -> tuple[int, int]:
    """The packets and bytes that the host of a process has sent."""
    lines = Path(f"/proc/{pid}/net/dev").read_text().splitlines()
    [line] = [line for line in lines if "eth0:" in line]
    words = [int(word) for word in line.partition(":")[2].split()]
    return words[9], words[8]


def counters(pid: int) -> Counters:
    """The counters of the namespace and the processes of the daemon `pid`."""
    names, values = (
        line.split()
        for line in Path(f"/proc/{pid}/net/netstat").read_text().splitlines()
        if line.startswith("IpExt:")
    )
    extra = {name: int(value) for name, value in zip(names[1:], values[1:], strict=True)}
    group = extra["OutMcastPkts"] + extra["OutBcastPkts"]
    group_size = extra["OutMcastOctets"] + extra["OutBcastOctets"] + ETHERNET * group
    host = sum(cpu_seconds(child) for child in children(pid))
    return Counters(*sent(pid), group, group_size, cpu_seconds(pid), host)


def measure(swarm: FieldSwarm, load: str, programs: Sequence[Lines], seconds: float) -> Measured:
    """Means over `seconds` of what each robot sends and uses, and what the programs send."""
    pids = [daemon.process.pid for daemon in swarm.daemons.values()]

    def sent_by_programs() -> tuple[int, int]:
        return sent(programs[0].pid) if programs else (0, 0)

    earlier = sent_by_programs()
    before, began = [counters(pid) for pid in pids], time.monotonic()
    time.sleep(seconds)
    after, passed = [counters(pid) for pid in pids], time.monotonic() - began
    later = sent_by_programs()

    def rate(name: str) -> float:
        pairs = zip(before, after, strict=True)
        grown = [float(getattr(b, name) - getattr(a, name)) for a, b in pairs]
        return statistics.mean(grown) / passed

    return Measured(
        robots=len(pids),
        load=load,
        programs=len(programs),
        program_packets=(later[0] - earlier[0]) / passed,
        program_size=(later[1] - earlier[1]) / passed,
        packets=rate("packets"),
        size=rate("size"),
        group_packets=rate("group_packets"),
        group_size=rate("group_size"),
        daemon_cpu=100.0 * rate("daemon_cpu"),
        host_cpu=100.0 * rate("host_cpu"),
        daemon_rss=statistics.mean(memory(pid, "Rss") for pid in pids),
        host_rss=statistics.mean(memory(children(pid)[-1], "Rss") for pid in pids),
        machine_load=os.getloadavg()[0],
    )


def run(swarm: FieldSwarm, load: str) -> None:
    """Put all robots under a load; AssertionError if some never take it."""
    missing = list(swarm.robots)

    def try_it() -> bool:
        nonlocal missing
        answer = swarm.ctl(
            "laptop", "run", *LOADS[load], *missing, "--timeout", "20s", "-o", "json"
        )
        applied = (answer.json or {}).get("applied", ())
        missing = [robot for robot in missing if robot not in applied]
        return not missing

    if LOADS[load]:
        wait_until(try_it, f"{load} by all", READY_TIMEOUT)


@contextlib.contextmanager
def programs_beside(
    swarm: FieldSwarm, number: int, channel: Sequence[str]
) -> Iterator[list[Lines]]:
    """So many Zenoh programs on the laptop, each linked to all robots; prints their times."""
    command = (*swarm.field.prefix("laptop"), sys.executable, "-m", PROGRAM, swarm.name)
    with contextlib.ExitStack() as left:
        programs = []
        for index in range(number):
            words = (f"program{number}-{index}", str(len(swarm.robots)), *channel)
            programs.append(Lines([*command, *words]))
            left.callback(programs[-1].close)
            print(f"program {index}, s after open: {programs[-1].hear()}", file=sys.stderr)
        yield programs


def measured(
    robots: int, loads: Sequence[str], programs: Sequence[int], seconds: float, settle: float
) -> list[Measured]:
    """A swarm of that many robots under each load, beside each number of programs."""
    names = [f"r{number:02d}" for number in range(1, robots + 1)]
    field = Field([*names, "laptop"], is_switched=False, neighbours=True)
    rows = []
    try:
        with tempfile.TemporaryDirectory() as folder:
            options: dict[str, object] = {"plugin_dir": str(PLUGINS)}
            with FieldSwarm(Path(folder), field, names, options, is_forked=False) as swarm:
                began = time.monotonic()
                for name in names:
                    swarm.spawn(name)
                    time.sleep(0.3)
                for daemon in swarm.daemons.values():
                    daemon.wait_ready()
                wait_until(lambda: len(swarm.states("laptop")) == robots, "all met", READY_TIMEOUT)
                print(f"{robots}: all met after {time.monotonic() - began:.0f} s", file=sys.stderr)
                for load in loads:
                    run(swarm, load)
                    for number in programs:
                        with programs_beside(swarm, number, CHANNELS[load]) as beside:
                            time.sleep(settle)
                            rows.append(measure(swarm, load, beside, seconds))
                        print("; ".join(rows[-1].cells), file=sys.stderr)
    finally:
        field.close()
    return rows


def main(arguments: Sequence[str] | None = None) -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--robots", type=int, nargs="+", default=[10, 20, 40])
    parser.add_argument("--loads", nargs="+", choices=LOADS, default=list(LOADS))
    parser.add_argument("--programs", type=int, nargs="+", default=[0], help="Zenoh programs")
    parser.add_argument("--seconds", type=float, default=20.0)
    parser.add_argument("--settle", type=float, default=15.0, help="s before each measurement")
    parser.add_argument("--json", type=Path, help="write a JSON line a row to this file")
    options = parser.parse_args(arguments)
    if why := lacks():
        sys.exit(why)
    rows = [
        row
        for robots in options.robots
        for row in measured(
            robots, options.loads, options.programs, options.seconds, options.settle
        )
    ]
    print(markdown([HEAD, *(row.cells for row in rows)]))
    if law := list(laws(rows)):
        print("\n" + markdown([LAW_HEAD, *law]))
    if options.json:
        options.json.write_text("".join(json.dumps(asdict(row)) + "\n" for row in rows))


if __name__ == "__main__":
    main()
