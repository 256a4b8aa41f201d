"""The figure of the page in the docs: `python -m studies.page_figure docs/figures/page.png`."""

from __future__ import annotations

import argparse
import subprocess
import sys
import tempfile
import time
from pathlib import Path

from tests.support.chromium import Browser, chromium


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
    parser.add_argument("file", type=Path)
    options = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder, chromium(Path(folder) / "chromium") as browser:
        figure(browser, options.file)


if __name__ == "__main__":
    main()
