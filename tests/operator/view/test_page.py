"""The page in a real browser shows and commands a living swarm, from click to acknowledgement."""

from __future__ import annotations

import contextlib
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING

import pytest
import zenoh

from swarmd.core.keys import token
from swarmd.core.messages import State
from tests.support.chromium import FOUND, Page
from tests.support.processes import free_port

if TYPE_CHECKING:
    from tests.swarm.conftest import Swarm

pytestmark = [
    pytest.mark.integration,
    pytest.mark.skipif(FOUND is None, reason="no Chromium here"),
]

STALE = "document.querySelector('tr[data-name=\"tb3-01\"]').className === 'stale'"
ANSWER = "document.querySelector('.answer')"
SPEED = "#params [name=speed]"
LAST = "document.querySelector('.answer[data-final=\"true\"]')"


@contextlib.contextmanager
def served(swarm: Swarm, *options: str, port: int = 0) -> Iterator[list[str]]:
    """`swarmctl view --web` for the swarm; the addresses that it prints."""
    process = swarm.begin("view", "--web", "--port", str(port), *options)
    try:
        count = 1 + ("--viewer-token" in options)
        lines = [process.out.readline() for _ in range(count)]
        yield [line.partition(": ")[2].strip() for line in lines]
    finally:
        process.terminate()
        process.finish()


def shown(page: Page, name: str, state: str) -> None:
    """Wait until the list shows a robot in a state."""
    page.until(
        f"(window.swarm.model.robots.get('{name}') || {{row: {{}}}}).row.state === '{state}'",
        f"{name} {state}",
    )


def answered(page: Page, verb: str) -> str:
    """The final answer to a command."""
    page.until(f"{LAST}.querySelector('.line').textContent.startsWith('{verb}:')", verb)
    return str(page.evaluate(f"{LAST}.textContent"))


def test_each_command_goes_from_click_to_acknowledgement(swarm: Swarm, page: Page) -> None:
    names = ["tb3-01", "tb3-02"]
    bodies = {name: swarm.body(name) for name in names}
    for name, body in bodies.items():
        swarm.start(name, body)
    with served(swarm) as (address,):
        page.open(address)
        for name in names:
            shown(page, name, "idle")
        page.until("swarm.model.links.length === 1", "they hear each other")
        page.click("#run-open")
        page.until("!!document.querySelector('#pattern-list [data-name=\"drive\"]')", "the list")
        page.click("#pattern-list [data-name='drive']")
        page.until(f"!!document.querySelector('{SPEED}')", "the parameters of the pattern")
        page.type(SPEED, "0.05")
        page.click("#run")
        while "came too late" in (answer := answered(page, "run")):  # a loaded machine
            page.click("#run")
        assert "2 targeted, 2 applied" in answer
        for name in names:
            shown(page, name, "running")
            bodies[name].wait_moving()
        page.until(
            "Number.isFinite(window.swarm.model.robots.get('tb3-01').x)",
            "a place",
        )

        page.evaluate("window.swarm.model.select(['tb3-01'])")
        page.until("document.getElementById('detail-values').children.length > 4", "details")
        page.evaluate("document.getElementById('stop').focus()")
        page.key(" ")
        assert "1 targeted, 1 applied" in answered(page, "stop")
        shown(page, "tb3-01", "stopped")
        assert swarm.status("tb3-02").state is State.RUNNING

        page.click("#run-open")  # a run that was applied closes it
        page.click("#param")
        assert "1 refused: no pattern is running" in answered(page, "param")
        page.type("#labels", "+red -blue")
        page.click("#set-labels")
        assert "1 targeted, 1 applied" in answered(page, "label")
        assert swarm.status("tb3-01").labels == ("red",)
        page.click("#estop")
        page.until("document.getElementById('estop-state').className === 'good'", "all stopped")
        assert "2 applied" in answered(page, "estop")
        for name in names:
            shown(page, name, "estopped")
        assert page.evaluate("document.getElementById('lost').hidden") is True
        bodies["tb3-02"].close()
        page.until("document.getElementById('lost').textContent.includes('tb3-02')", "lost")
        page.click("#reset")
        assert "1 targeted, 1 applied" in answered(page, "reset")
        shown(page, "tb3-01", "idle")
        assert page.errors == []


def test_a_lost_server_is_found_again_and_a_killed_robot_is_not_shown_as_alive(
    swarm: Swarm, page: Page
) -> None:
    daemon, port = swarm.start("tb3-01", swarm.body("tb3-01")), free_port()
    with served(swarm, port=port) as (address,):
        page.open(address)
        shown(page, "tb3-01", "idle")
    page.until("!document.getElementById('banner').hidden", "the banner")
    page.until(STALE, "a stale row")
    page.click("#stop")
    page.until(f"{ANSWER}.textContent.includes('not sent')", "not sent")
    process = swarm.begin("view", "--web", "--port", str(port))
    try:
        page.until("document.getElementById('banner').hidden", "no banner")
        shown(page, "tb3-01", "idle")
        page.until(f"!({STALE})", "a fresh row")
        daemon.kill()
        page.until(STALE, "a stale row")
    finally:
        process.terminate()
        process.finish()


def test_tokens_decide_who_may_command(swarm: Swarm, page: Page, tmp_path: Path) -> None:
    body = swarm.body("tb3-01")
    swarm.start("tb3-01", body)
    files = tmp_path / "operator", tmp_path / "viewer"
    files[0].write_text("secret-a")
    files[1].write_text("secret-b")
    tokens = ("--token", str(files[0]), "--viewer-token", str(files[1]))
    with served(swarm, *tokens) as (whole, read_only):
        page.open(read_only)
        shown(page, "tb3-01", "idle")
        assert (
            page.evaluate("getComputedStyle(document.getElementById('actions')).display") == "none"
        )
        page.evaluate(
            "window.swarm.actions.act('run', {targets: ['tb3-01'], pattern: 'drive', params: ''})"
        )
        assert "this page may only look" in answered(page, "run")
        assert swarm.status("tb3-01").state is State.IDLE

        page.evaluate("sessionStorage.clear()")  # else the tab keeps its token
        page.open(whole.partition("?")[0])
        page.until("document.getElementById('banner').textContent.includes('token')", "refused")
        page.open(whole)
        shown(page, "tb3-01", "idle")


def test_the_list_names_zenoh_programs_until_they_leave(swarm: Swarm, page: Page) -> None:
    swarm.start("tb3-01")
    with served(swarm) as [address], zenoh.open(zenoh.Config()) as program:
        page.open(address)
        shown(page, "tb3-01", "idle")
        line = "document.getElementById('programs')"
        assert page.evaluate(f"{line}.hidden")
        held = program.liveliness().declare_token(token(swarm.name, "teacher"))
        page.until(f"{line}.textContent.includes('teacher') && !{line}.hidden", "the program")
        assert page.evaluate("document.querySelectorAll('tr[data-name]').length") == 1
        held.undeclare()
        page.until(f"{line}.hidden", "the program has left")


def test_another_interface_needs_a_token(swarm: Swarm) -> None:
    done = swarm.ctl("view", "--web", "--bind", "0.0.0.0", "--port", "0")
    assert done.code == 2
    assert "expected a token" in done.err
