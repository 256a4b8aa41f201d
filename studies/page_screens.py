"""Screenshots of the page for review: light and dark, 3 to 200 robots, four widths, each panel.

`make screens` writes them to `build/screens`. The robots' messages are generated, with robots in
all states. With `--figure FILE` this program writes the figure of the docs instead, which shows a
simulated world.
"""

from __future__ import annotations

import argparse
import functools
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator, Sequence
from contextlib import closing, contextmanager
from pathlib import Path
from typing import Any, cast

from swarmd.cli.plugin_check import describe_patterns
from swarmd.cli.web import Served, WebOptions
from swarmd.core.messages import Health, Reason, State
from swarmd.network.operator.operator import Operator
from swarmd.plugins import pattern_names
from swarmd.view.commander import LiveCommander
from swarmd.view.live import LiveSource
from tests.support.chromium import Browser, Page, chromium
from tests.support.fed_swarm import FedOperator, FedSwarm

COUNTS = 3, 7, 40, 200
WINDOWS = {
    "small": (320, 640),
    "phone": (390, 844),
    "laptop": (1280, 720),
    "projector": (1920, 1080),
}
SETTLE = 4.0
"""Seconds of a living swarm before its picture is taken, for trails and plots."""
KINDS: Sequence[tuple[State, dict[str, Any]]] = (
    (State.RUNNING, {}),
    (State.RUNNING, {"reason": Reason.NO_REQUESTED_COMMAND}),
    (State.RUNNING, {}),
    (State.STOPPED, {}),
    (State.ESTOPPED, {}),
    (State.RUNNING, {"reason": Reason.NO_SCAN, "detail": "for 1.2 s"}),
    (State.IDLE, {}),
)
FREE = Path("build/screens")


@contextmanager
def served(count: int) -> Iterator[tuple[FedSwarm, str]]:
    """A fed swarm with robots in all states, and the address of its page."""
    with FedSwarm(count) as swarm:
        make = cast("Any", lambda: cast("Operator", FedOperator(swarm)))
        describe = functools.partial(describe_patterns, (), None)
        source = LiveSource(make(), sorted(pattern_names(None)), describe)
        commander = LiveCommander(make, source.expected)
        source.start()
        try:
            with closing(Served(source, commander, WebOptions("127.0.0.1", 0))) as page:
                yield swarm, page.addresses[0].partition(": ")[2]
        finally:
            commander.close()
            source.close()


def vary(swarm: FedSwarm) -> None:
    """Set the states of the robots; the base of an estopped robot is lost."""
    for i, name in enumerate(swarm.names):
        state, changes = KINDS[i % len(KINDS)]
        if state is not State.RUNNING or changes:
            swarm.change(name, state, **changes)
    lost = swarm.names[min(4, len(swarm.names) - 1)]
    health = Health(driver="/dev/ttyACM0: no such device", driver_up=False)
    swarm.change(lost, State.ESTOPPED, health=health)


def begin(page: Page, address: str, window: str, theme: str, count: int) -> None:
    """Open a page of a size and theme, and wait for its robots."""
    width, height = WINDOWS[window]
    page.resize(width, height, is_phone=width < 900)
    page.open(address)
    page.evaluate(f"localStorage.setItem('dark', {str(theme == 'dark').lower()})")
    page.open(address)
    known = "[...swarm.model.robots.values()].filter((one) => one.row.state && one.x === one.x)"
    page.until(f"{known}.length === {count}", f"{count} robots")


def overviews(browser: Browser, folder: Path) -> None:
    """The page as it opens, in each size and theme, with each number of robots."""
    for count in COUNTS:
        with served(count) as (swarm, address):
            time.sleep(SETTLE)
            vary(swarm)
            for window in WINDOWS:
                for theme in ("light", "dark"):
                    with browser.page() as page:
                        begin(page, address, window, theme, count)
                        time.sleep(1.0)
                        page.picture(folder / f"{count:03d}_{window}_{theme}.png")


def panels(browser: Browser, folder: Path) -> None:
    """Each panel, an emergency stop that lacks a robot, refusals, the past, and the map alone."""
    choose = "swarm.panels.open('commands', true); swarm.actions.form.choose('dispersion')"
    run = "swarm.actions.act('run', {targets: swarm.actions.named(), pattern: 'disperson'})"
    more = "document.getElementById('detail-more')"
    steps = {
        "run": choose,
        "table": "swarm.panels.open('list-pane', true); swarm.model.select(['tb3-002'])",
        "details": f"swarm.model.select(['tb3-001']); {more}.open = true",
        "look": "swarm.panels.open('look', true)",
        "protection": "swarm.map.colourBy('protection')",
        "refused": run,
        "past": "swarm.panels.open('time', true); swarm.plots.to(swarm.model.plots.times[1])",
        "map_only": "swarm.panels.present(true)",
        "estop": "swarm.actions.estop()",
    }
    with served(7) as (swarm, address):
        time.sleep(SETTLE)
        vary(swarm)
        for name, script in steps.items():
            swarm.silent |= {"tb3-006"} if name == "estop" else set()
            for window in WINDOWS:
                with browser.page() as page:
                    begin(page, address, window, "dark" if name == "look" else "light", 7)
                    page.until("swarm.model.patterns.some((one) => one.params)", "parameters")
                    page.until("swarm.model.plots.times.length > 3", "moments")
                    page.evaluate(f"(() => {{ {script}; }})()")
                    time.sleep(1.5)
                    page.picture(folder / f"{name}_{window}.png")


def figure(browser: Browser, file: Path) -> None:
    """A simulated world of seven robots that flock, one selected."""
    words = ("demo", "--web", "--headless", "-n", "7", "--seconds", "600", "--port", "0")
    command = [str(Path(sys.executable).with_name("swarmctl")), *words, "--pattern", "flocking"]
    with (
        tempfile.TemporaryDirectory() as folder,
        subprocess.Popen(command, cwd=folder, stderr=subprocess.PIPE, text=True) as process,
        browser.page(1400, 850) as page,
    ):
        assert process.stderr is not None
        try:
            lines = iter(process.stderr.readline, "")
            address = next(one for one in lines if one.startswith("page: ")).partition(": ")[2]
            page.open(address.strip())
            page.evaluate("document.getElementById('overload').style.display = 'none'")
            page.evaluate("swarm.panels.open('list-pane', true)")
            page.until("swarm.model.plots.times.length > 45", "most of a minute", 300.0)
            page.evaluate("swarm.model.select(['tb3-03'])")
            page.until("document.getElementById('detail-why').textContent.length > 3", "details")
            time.sleep(1.5)
            page.picture(file)
        finally:
            process.terminate()


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--out", type=Path, default=FREE)
    parser.add_argument("--figure", type=Path)
    options = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder, chromium(Path(folder) / "chromium") as browser:
        if options.figure is not None:
            figure(browser, options.figure)
            return
        overviews(browser, options.out)
        panels(browser, options.out)
    print(f"{options.out}: {len([*options.out.glob('*.png')])} pictures")


if __name__ == "__main__":
    main()
