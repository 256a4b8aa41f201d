"""Who runs the blocks of a page: a folder, and three robots where the page needs some."""

from __future__ import annotations

import contextlib
import doctest
import os
import re
import shutil
import subprocess
import sys
import types
from collections.abc import Mapping
from pathlib import Path
from typing import Self
from unittest import mock

import yaml

from swarmd.sim.live.simulated_swarm import demo
from tests.support.pages import Printed, difference
from tests.support.processes import unique_swarm

ROOT = Path(__file__).resolve().parents[2]
VARYING = (
    (r"\b\d\d:\d\d:\d\d\b", "TIME"),
    (r"\b\d+\.\d+\.\d+\.\d+:\d+\b", "ADDRESS"),
    (r"\b[\w.-]+@[\w.-]+", "OPERATOR"),
    (r"\b[\d.]+ m?s ago\b", "AGE"),
    (r"\b[\d.]+ ms\b", "DURATION"),
)
"""What is another in each run of a living swarm, in a page and in what a command gives."""
PROCESS = re.compile(r"\b([\w-]+)@default\b")
"""The process of a robot of the default swarm, as `pkill -x` takes its name."""


class Reader:
    """Runs the blocks of a page in `folder`, where the files of the page are; a context manager.

    With `has_robots`, three simulated Burgers are up. Their names are those of no other swarm of
    this machine, so that `pkill -x` ends no other robot. `swarmctl sim up` starts them anew.
    """

    def __init__(self, folder: Path, files: Mapping[str, str], *, has_robots: bool = False) -> None:
        self.folder = folder
        self.has_robots = has_robots
        self.swarm = unique_swarm()
        self.robots = f"r{self.swarm[-7:]}"
        self.module = types.ModuleType("snippets")
        self._started = contextlib.ExitStack()
        self.module.__dict__["keep_open"] = self._started.enter_context
        programs = f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}"
        self.environ = {"HOME": str(folder / "home"), "SWARM": self.swarm, "PATH": programs}
        (folder / "home").mkdir()
        for name, text in files.items():
            (folder / name).parent.mkdir(parents=True, exist_ok=True)
            (folder / name).write_text(text)

    def __enter__(self) -> Self:
        sys.modules[self.module.__name__] = self.module  # where structs look their names up
        if self.has_robots:
            self._start()
        return self

    def __exit__(self, *_: object) -> None:
        del sys.modules[self.module.__name__]
        self._started.close()

    def run(self, command: str) -> tuple[str, ...]:
        """What a command prints; the same with standard error, before it and behind it."""
        if command.startswith("swarmctl sim up"):
            self._start()
            return ()
        done = subprocess.run(
            ["bash", "-c", self._own(command)],
            capture_output=True,
            text=True,
            stdin=subprocess.DEVNULL,
            cwd=self.folder,
            env={**os.environ, **self.environ},
            check=False,
        )
        out, error = (self._shown(text) for text in (done.stdout, done.stderr))
        return out, error + out, out + error

    def fault(self, printed: Printed) -> str | None:
        """A line about printed output that its commands do not give."""
        given = [self.run(command) for command in printed.commands][-1]
        wanted = _without_varying(printed.text)
        found = [difference(wanted, _without_varying(text)) for text in given]
        return f"{printed.page}:{printed.line}: {found[-1]}" if all(found) else None

    def execute(self, source: str, page: str) -> None:
        """Run Python in the folder, in the one module of all snippets of the page.

        A snippet may be a session of the interpreter, with what its expressions give.
        """
        source = self._own(source)
        with contextlib.chdir(self.folder), mock.patch.dict(os.environ, self.environ):
            if source.lstrip().startswith(">>>"):
                _check_session(source, self.module.__dict__, page)
            else:
                exec(compile(source, page, "exec"), self.module.__dict__)

    def _start(self) -> None:
        self._started.close()
        for example in (ROOT / "examples").glob("*.py"):
            shutil.copy(example, self.folder)
        group = {"platform": "burger", "count": 3, "start": {"layout": "grid", "spacing": 1.2}}
        scenario = {
            "description": "the robots of a reader",
            "duration": 600,
            "arena": {"size": [6, 6]},
            "groups": {self.robots: group},
            "plugin_dir": str(self.folder),
            "fields": [{"kind": "uniform", "name": "battery", "value": 0.15}],
        }
        path = self.folder / "robots.yaml"
        path.write_text(yaml.safe_dump(scenario))
        self._started.enter_context(demo(path, swarm=self.swarm))

    def _own(self, text: str) -> str:
        """The names of robots and swarms of the page become those of this reader."""
        if not self.has_robots:
            return text
        text = text.replace("tb3", self.robots).replace("meadow", self.swarm)
        # Linux keeps 15 characters of the name of a process.
        return PROCESS.sub(lambda found: f"{found[1]}@{self.swarm}"[:15], text)

    def _shown(self, text: str) -> str:
        text = text.replace(f"{ROOT}/", "").replace(f"{self.folder}/", "")
        return text.replace(self.robots, "tb3")


def _check_session(source: str, names: dict[str, object], page: str) -> None:
    session = doctest.DocTestParser().get_doctest(source, names, page, page, 0)
    try:
        doctest.DebugRunner(optionflags=doctest.ELLIPSIS).run(session, clear_globs=False)
    except doctest.DocTestFailure as failure:
        wanted, got = failure.example.want.strip(), failure.got.strip()
        raise AssertionError(f"the page has {wanted}, the example gives {got}") from None


def _without_varying(text: str) -> str:
    for pattern, word in VARYING:
        text = re.sub(pattern, word, text)
    return text
