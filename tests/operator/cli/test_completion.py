"""Completion of lines in shells: what Tab offers, and how soon and quietly."""

from __future__ import annotations

import contextlib
import json
import os
import pty
import shutil
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from pathlib import Path

import pytest

from swarmd.link.settings import NetworkSettings
from swarmd.operator.session.members_view import MembersView
from swarmd.operator.session.targets import (
    EMPTY_AGE,
    MAX_AGE,
    MAX_SWARMS,
    known_names,
    remember,
)
from tests.support.processes import unique_swarm, wait_until
from tests.support.statuses import make_member
from tests.support.swarmctl import Running

RUN = f"{sys.executable} -c 'from swarmd.operator.cli.entry import swarmctl; swarmctl()'"


@pytest.fixture
def cache(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A cache of this test's own, with the robots of a swarm that $SWARM names."""
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    monkeypatch.setenv("SWARM", unique_swarm())
    remember(NetworkSettings(swarm=os.environ["SWARM"]), view("tb3-01", "tb3-02", "waffle"))
    return tmp_path / "swarmd"


def view(*names: str) -> MembersView:
    return MembersView({name: make_member(name) for name in names})


def completed(*words: str, shell: str = "bash", **environ: str) -> list[str]:
    """What a shell gets for the last word, line by line; nothing may be on standard error."""
    done = Running(
        environ={
            "COMP_WORDS": " ".join(("swarmctl", *words)),
            "COMP_CWORD": str(len(words)),
            "_SWARMCTL_COMPLETE": f"{shell}_complete",
            **environ,
        }
    ).finish()
    assert done.err == ""
    return [line.removeprefix("plain,") for line in done.out.splitlines() if line]


@pytest.mark.integration
@pytest.mark.parametrize(
    ("words", "offered"),
    [
        (("ev",), ["events"]),
        (("describe", "tb"), ["tb3-01", "tb3-02"]),
        (("stop", "tb3-01", ""), ["tb3-02", "waffle"]),
        (("run", "attr"), ["attraction"]),
        (("run", "attraction", "--exclude", "w"), ["waffle"]),
        (("run", "attraction", "-l", "r"), ["red"]),
        (("patterns", "list", "--platform", "burg"), ["burger", "burger_lds02"]),
        (("demo", "circ"), ["circle_formation"]),
        (("completion", "f"), ["fish"]),
    ],
)
def test_tab_offers_names(cache: Path, words: tuple[str, ...], offered: list[str]) -> None:
    assert completed(*words) == offered


@pytest.mark.integration
def test_the_swarm_of_the_line_decides_whose_robots_are_offered(cache: Path) -> None:
    other = unique_swarm()
    remember(NetworkSettings(swarm=other), view("jackal"))
    assert completed("--swarm", other, "describe", "") == ["jackal"]
    assert sorted(completed("--swarm", "t")) == sorted((other, os.environ["SWARM"]))


@pytest.mark.integration
@pytest.mark.parametrize("shell", ["zsh", "fish"])
def test_other_shells_get_names_in_their_form(cache: Path, shell: str) -> None:
    word = {"COMP_CWORD": "tb3-01"} if shell == "fish" else {}
    assert "tb3-01" in "\n".join(completed("describe", "tb3-01", shell=shell, **word))


@pytest.mark.integration
@pytest.mark.parametrize(
    "environ",
    [{"SWARM_CONFIG": "/nowhere.yaml"}, {"SWARM": "../x"}, {"XDG_CACHE_HOME": "/dev/null/x"}],
    ids=["no config", "no name", "no cache"],
)
def test_what_is_wrong_is_silent(cache: Path, environ: dict[str, str]) -> None:
    assert completed("describe", "", **environ) == []


@pytest.mark.integration
def test_a_damaged_cache_is_ignored(cache: Path) -> None:
    (file,) = cache.iterdir()
    for text in ("[", "{}", '{"names": [1, "a b", "good"]}', "7", '{"names": 7}', "[]"):
        file.write_text(text)
        assert completed("describe", "g") == (["good"] if "good" in text else [])


class _Looks:
    """An operator that counts its looks."""

    def __init__(self, found: MembersView) -> None:
        self.settings = NetworkSettings(swarm=os.environ["SWARM"])
        self.found, self.count = found, 0

    def members(self, **_: object) -> MembersView:
        self.count += 1
        return self.found


def test_names_that_are_old_are_looked_up_and_kept_if_no_robot_answers(cache: Path) -> None:
    (file,) = cache.iterdir()
    looks = _Looks(view("new"))
    assert known_names(looks) == ["tb3-01", "tb3-02", "waffle"]  # type: ignore[arg-type]
    assert looks.count == 0
    past = time.time() - MAX_AGE - 1.0
    os.utime(file, (past, past))
    assert known_names(looks) == ["new"]  # type: ignore[arg-type]
    os.utime(file, (past, past))
    looks.found = view()
    assert known_names(looks) == ["new"]  # type: ignore[arg-type]
    assert json.loads(file.read_text()) == {"names": ["new"], "labels": ["red"]}
    assert known_names(looks) == ["new"]  # type: ignore[arg-type]
    assert looks.count == 2


def test_a_look_without_robots_is_repeated_soon(cache: Path) -> None:
    (file,) = cache.iterdir()
    file.unlink()
    looks = _Looks(view())
    assert known_names(looks) == known_names(looks) == []  # type: ignore[arg-type]
    assert looks.count == 1
    past = time.time() - EMPTY_AGE - 1.0
    os.utime(file, (past, past))
    known_names(looks)  # type: ignore[arg-type]
    assert looks.count == 2


def test_the_cache_keeps_a_bounded_number_of_swarms(cache: Path) -> None:
    for number in range(MAX_SWARMS + 3):
        remember(NetworkSettings(swarm=f"s{number}"), view("r"))
    assert len(list(cache.iterdir())) == MAX_SWARMS


@contextlib.contextmanager
def interactive_bash(folder: Path) -> Iterator[tuple[int, list[str]]]:
    """A bash on a pseudo-terminal that has loaded the script; its terminal, and what it wrote."""
    command = folder / "swarmctl"
    command.write_text(f'#!/bin/sh\nexec {RUN} "$@"\n')
    command.chmod(0o755)
    main, child = pty.openpty()
    process = subprocess.Popen(
        ["bash", "--norc", "--noprofile", "-i"],
        stdin=child,
        stdout=child,
        stderr=child,
        start_new_session=True,
        env={**os.environ, "PATH": f"{folder}:{os.environ['PATH']}", "PS1": "> ", "TERM": "dumb"},
    )
    written: list[str] = []

    def read() -> None:
        with contextlib.suppress(OSError):
            while data := os.read(main, 65536):
                written.append(data.decode(errors="replace"))

    reading = threading.Thread(target=read, daemon=True)
    reading.start()
    try:
        os.write(main, b'eval "$(swarmctl completion bash)"; echo ready $?\n')
        wait_until(lambda: "ready 0" in "".join(written), "bash has the script")
        yield main, written
    finally:
        process.kill()
        process.wait()
        os.close(child)
        reading.join()
        os.close(main)


@pytest.mark.integration
@pytest.mark.skipif(shutil.which("bash") is None, reason="no bash here")
def test_tab_in_a_real_bash(cache: Path, tmp_path: Path) -> None:
    with interactive_bash(tmp_path) as (terminal, written):
        written.clear()
        os.write(terminal, b"swarmctl desc\twaf\t")
        wait_until(lambda: "describe waffle " in "".join(written), "Tab completes both words")
        written.clear()
        os.write(terminal, b"\x15swarmctl stop tb\t\t\t")
        wait_until(lambda: "tb3-02" in "".join(written), "Tab lists what is possible")
        assert "rror" not in "".join(written)
