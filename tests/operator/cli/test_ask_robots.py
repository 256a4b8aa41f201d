"""Answers of robots to a question that changes nothing."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import pytest

from swarmd.core.codec import encode
from swarmd.core.verbs import LINKS, LinksReply
from swarmd.operator.cli.ask_robots import ask_robots


def test_an_answer_in_the_name_of_another_robot_is_left_out(
    capsys: pytest.CaptureFixture[str],
) -> None:
    own, forged = LinksReply(robot="r1", links=()), LinksReply(robot="r1\x1b[2J", links=())
    answers = {"r1": encode(own), "r2": encode(forged)}
    operator: Any = SimpleNamespace(ask_all=lambda *_, **__: answers)
    options: Any = SimpleNamespace(timeout=None, began=0.0)
    assert ask_robots(options, operator, answers, LINKS) == {"r1": own}
    assert "r2: its answer is in the name of r1?[2J" in capsys.readouterr().err
