"""The outcome of a request in words: a line for each robot that applied it, each reason once."""

from __future__ import annotations

import json
from types import SimpleNamespace
from typing import Any, cast

import click
import pytest

from swarmd.core.messages import Code, Reply
from swarmd.core.refusal import Refusal
from swarmd.link.settings import NetworkSettings
from swarmd.operator.cli.options import CommonOptions
from swarmd.operator.cli.send import show
from swarmd.operator.cli.swarmctl import exit_code_of
from swarmd.operator.session.exit_codes import UNREACHABLE
from swarmd.operator.session.outcome import Outcome
from swarmd.operator.session.session import unreachable


def refused(robot: str, text: str, refusal: Refusal = Refusal.ESTOPPED) -> Reply:
    return Reply(id="q", robot=robot, code=Code.REFUSED, refusal=refusal, text=text)


def outcome(*replies: Reply, missing: tuple[str, ...] = ()) -> Outcome:
    return Outcome({one.robot: one for one in replies}, missing=missing)


def show_it(found: Outcome, form: str = "table") -> None:
    with click.Context(click.Command("run"), info_name="run"):
        show(CommonOptions(output=form), found)


def test_robots_with_one_reason_are_in_one_line(capsys: pytest.CaptureFixture[str]) -> None:
    applied = Reply(id="q", robot="r1", code=Code.APPLIED, text="runs drive")
    stopped = [refused(f"r{n}", "estopped by bob") for n in (2, 3)]
    show_it(outcome(applied, *stopped, refused("r4", "faulted"), missing=("r5", "r6")))
    lines = capsys.readouterr().out.splitlines()
    assert [line.split() for line in lines[1:-1]] == [
        ["2", "robots", "no", "answer", "-:", "r5,", "r6"],
        ["2", "robots", "refused", "estopped", "by", "bob:", "r2,", "r3"],
        ["r1", "applied", "runs", "drive"],
        ["r4", "refused", "faulted"],
    ]


def test_a_mistake_is_said_once_and_the_count_has_the_robots(
    capsys: pytest.CaptureFixture[str],
) -> None:
    known = [refused(f"r{n}", "no parameter 'sped'", Refusal.INVALID_PARAMETER) for n in (1, 2)]
    show_it(outcome(*known, missing=("r3",)))
    said = capsys.readouterr()
    assert (said.out + said.err).count("no parameter 'sped'") == 1
    assert "(r1, r2)" in said.out
    assert "r3" in said.out
    show_it(outcome(*known), "json")
    assert "no parameter 'sped'" in json.loads(capsys.readouterr().out)["error"]


@pytest.mark.parametrize(("found", "is_named"), [((), True), (("lab",), False)])
def test_where_no_swarm_answers_sim_up_is_named(found: tuple[str, ...], is_named: bool) -> None:
    settings = NetworkSettings(swarm="meadow")
    operator = SimpleNamespace(settings=settings, identity=None, swarms=lambda: found)
    error = unreachable(cast(Any, operator))
    assert ("`swarmctl sim up`" in str(error), exit_code_of(error)) == (is_named, UNREACHABLE)
