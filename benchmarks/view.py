"""The page of `swarmctl view --web` in a headless Chromium, with robots whose messages are fed.

The server runs in a process of its own and gets a motion of each robot ten times and a status once
a second, encoded; it decodes them, as it does those that come by Zenoh. The page is 1400 x 850
pixels large, with trails of all robots, and the list. A long task is one over 50 ms in the page's
main thread, later than START s after it knows all robots.
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

from benchmarks.resources import cpu_seconds
from benchmarks.table import Row, print_table
from tests.support.chromium import FOUND, Browser, Page, chromium

ROBOTS = 7, 100, 500
SECONDS = 15.0
START = 3.0
TASK_BUDGET, CPU_BUDGET = "max 50 ms", "25 %"
SIZE_BUDGET = "0.2 MB"


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
    """The rows of so many robots."""
    with server(count) as (pid, address), browser.page() as page:
        page.open(address)
        known = "[...swarm.model.robots.values()].filter((r) => r.row.state && r.x === r.x).length"
        page.until(f"{known} === {count}", f"{count} robots")
        time.sleep(START)
        page.call("Performance.enable", timeDomain="threadTicks")
        before = cpu_seconds(pid), page.evaluate("performance.now()"), busy(page)
        watch_tasks(page)
        time.sleep(seconds)
        after = cpu_seconds(pid), page.evaluate("performance.now()"), busy(page)
        passed = (after[1] - before[1]) / 1e3
        frames = page.evaluate("window.arrivals.length") / passed
        tasks = [one / 1e3 for one in page.evaluate("window.tasks")]
        gaps = page.evaluate("window.arrivals.slice(1).map((at, i) => at - window.arrivals[i])")
        assert page.errors == []
    note = f"over {passed:.0f} s"
    long = len(tasks) - 1
    yield Row(
        f"page, {count} robots: longest task",
        [max(tasks)],
        TASK_BUDGET,
        f"{long} over 50 ms, {note}",
    )
    yield Row(f"page, {count} robots: from frame to frame", [gap / 1e3 for gap in gaps])
    yield Row(f"page, {count} robots: frames a second", [frames], ">= 9 x", unit="x")
    share = 100.0 * (after[2] - before[2]) / passed
    yield Row(f"page, {count} robots: CPU of the main thread", [share], unit="%")
    used = 100.0 * (after[0] - before[0]) / passed
    yield Row(f"server, {count} robots: CPU", [used], CPU_BUDGET, "of one core, with decoding", "%")


def busy(page: Page) -> float:
    """Processor time in s that tasks of the page's main thread have taken."""
    metrics = page.call("Performance.getMetrics")["metrics"]
    return next(float(one["value"]) for one in metrics if one["name"] == "TaskDuration")


def watch_tasks(page: Page) -> None:
    """Collect long tasks and the arrival of frames, in ms; the first 0: no long task."""
    page.evaluate("""(() => {
      window.tasks = [0];
      window.arrivals = [];
      new PerformanceObserver((list) => {
        for (const one of list.getEntries()) window.tasks.push(one.duration);
      }).observe({ type: 'longtask' });
      let last = swarm.model.sequence;
      swarm.model.addEventListener('frame', () => {
        if (swarm.model.sequence === last) return; // a scan
        last = swarm.model.sequence;
        window.arrivals.push(performance.now());
      });
    })()""")


def rows(robots: Sequence[int] = ROBOTS, seconds: float = SECONDS) -> Iterator[Row]:
    yield Row("page: all files", [size()], SIZE_BUDGET, unit="MB")
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
