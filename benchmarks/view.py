"""Speed of the page of `swarmctl view --web` in a headless Chromium, with generated messages.

The server runs in a process of its own. A generator hands it encoded messages, ten motions and one
status of each robot per second, which the server decodes like messages that arrive over Zenoh. The
page has 1400 x 850 pixels, and shows the list and the trails of all robots. The browser traces the
tasks of the page's main thread, from START s after the page knows all robots.
"""

from __future__ import annotations

import argparse
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from importlib.resources import files
from pathlib import Path

import numpy as np

from benchmarks.resources import cpu_seconds
from benchmarks.table import Row, print_table
from tests.support.chromium import FOUND, Browser, Page, chromium

ROBOTS = 7, 100, 500
SECONDS = 15.0
START = 3.0
TASK_GOAL, CPU_GOAL = "max 50 ms", "25 %"
SIZE_GOAL = "0.2 MB"


def size() -> float:
    """All files of the page, in MB."""
    return (
        sum(len(file.read_bytes()) for file in files("swarmd.view").joinpath("page").iterdir())
        / 1e6
    )


@contextmanager
def server(count: int) -> Iterator[tuple[int, str]]:
    """The process id of a server, and the address of its page."""
    command = [sys.executable, "-m", "tests.support.fed_swarm", str(count)]
    with subprocess.Popen(
        command, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True
    ) as one:
        assert one.stdout is not None
        try:
            yield one.pid, one.stdout.readline().partition(": ")[2].strip()
        finally:
            one.terminate()


def measure(browser: Browser, count: int, seconds: float) -> Iterator[Row]:
    """The rows of the table for `count` robots."""
    with server(count) as (pid, address), browser.page() as page:
        page.open(address)
        known = "[...swarm.model.robots.values()].filter((r) => r.row.state && r.x === r.x).length"
        page.until(f"{known} === {count}", f"{count} robots")
        time.sleep(START)
        watch_frames(page)
        before, began = cpu_seconds(pid), time.monotonic()
        tasks = trace(page, seconds)
        passed = time.monotonic() - began
        server_share = 100.0 * (cpu_seconds(pid) - before) / passed
        arrivals = page.evaluate("window.arrivals")
        assert page.errors == []
    name, note = f"page, {count} robots", f"over {seconds:.0f} s"
    wall, cpu = zip(*tasks, strict=True)
    yield Row(f"{name}: a task of the main thread", wall, TASK_GOAL, note)
    yield Row(f"{name}: its processor time", cpu, TASK_GOAL, "without what else the machine did")
    yield Row(f"{name}: from frame to frame", np.diff(arrivals) / 1e3)
    rate = 1e3 * (len(arrivals) - 1) / (arrivals[-1] - arrivals[0])
    yield Row(f"{name}: frames a second", [rate], ">= 9 x", unit="x")
    yield Row(f"{name}: CPU of the main thread", [100.0 * sum(cpu) / seconds], unit="%")
    note = "of one core, with decoding"
    yield Row(f"server, {count} robots: CPU", [server_share], CPU_GOAL, note, "%")


def trace(page: Page, seconds: float) -> list[tuple[float, float]]:
    """(duration, processor time) in s of each task of the page's main thread, for `seconds`."""
    config = {"includedCategories": ["toplevel", "__metadata"], "excludedCategories": ["*"]}
    page.call("Tracing.start", transferMode="ReportEvents", traceConfig=config)
    time.sleep(seconds)
    page.call("Tracing.end")
    parts = page.events_until("Tracing.tracingComplete")
    events = [event for part in parts for event in part.get("value", ())]
    mains = {
        (event["pid"], event["tid"])
        for event in events
        if event["name"] == "thread_name" and event["args"]["name"] == "CrRendererMain"
    }
    return [
        (event["dur"] / 1e6, event.get("tdur", 0) / 1e6)
        for event in events
        if event["name"].endswith("::RunTask")
        and (event["pid"], event["tid"]) in mains
        and "dur" in event  # else it goes on after the trace
    ]


def watch_frames(page: Page) -> None:
    """Note when frames arrive, in ms."""
    page.evaluate("""(() => {
      window.arrivals = [];
      let last = swarm.model.sequence;
      swarm.model.addEventListener('frame', () => {
        if (swarm.model.sequence === last) return; // a scan
        last = swarm.model.sequence;
        window.arrivals.push(performance.now());
      });
    })()""")


def rows(robots: Sequence[int] = ROBOTS, seconds: float = SECONDS) -> Iterator[Row]:
    yield Row("page: all files", [size()], SIZE_GOAL, unit="MB")
    if FOUND is None:
        yield Row("page", [], note="no Chromium here")
        return
    with tempfile.TemporaryDirectory() as folder, chromium(Path(folder) / "chromium") as browser:
        for count in robots:
            yield from measure(browser, count, seconds)


def main(arguments: Sequence[str] | None = None) -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seconds", type=float, default=SECONDS)
    parser.add_argument("--robots", type=int, nargs="*", default=ROBOTS)
    options = parser.parse_args(arguments)
    print_table("Page of a swarm", rows(options.robots, options.seconds))


if __name__ == "__main__":
    main()
