"""The table of verbs: each row has what answers the verb, and the rows are those of the types."""

from __future__ import annotations

from importlib import import_module
from typing import Any, get_args

import pytest

from swarmd.core.verbs import VERBS, AnyRequest, Handler, Request, Verb
from swarmd.daemon.code_transfer import CodeIntake, CodePull
from swarmd.daemon.recorder import RecordingService
from swarmd.daemon.requests import RequestServer
from swarmd.daemon.roster_service import RosterService
from swarmd.daemon.tools import FieldTools
from swarmd.network.carriers.inbound_queue import DropCounter
from swarmd.robot.requests import RequestHandler

SERVICES = (CodeIntake, CodePull, FieldTools, RecordingService, RosterService)


def of(handler: Handler) -> list[Verb[Any, Any]]:
    return [row for row in VERBS.values() if row.handler is handler]


def test_each_type_of_request_has_a_row() -> None:
    assert {row.asked for row in VERBS.values() if row.is_request} == set(get_args(AnyRequest))
    assert {row.asked for row in of(Handler.ROBOT)} == set(get_args(Request))


def test_each_verb_of_the_robot_has_a_method() -> None:
    assert [
        row.name for row in of(Handler.ROBOT) if not hasattr(RequestHandler, f"on_{row.name}")
    ] == []


@pytest.mark.parametrize("verb", [row.name for row in of(Handler.DAEMON)])
def test_each_verb_of_the_daemon_has_one_service(verb: str) -> None:
    assert len([one for one in SERVICES if hasattr(one, f"on_{verb}")]) == 1


def test_a_daemon_without_the_service_of_a_verb_does_not_start() -> None:
    audit: Any = None
    with pytest.raises(LookupError, match="on_push"):
        RequestServer("r1", lambda request: None, audit, drops=DropCounter())


def test_only_stops_need_no_epoch_of_the_robot() -> None:
    assert {row.name for row in of(Handler.ROBOT) if not row.needs_epoch} == {"stop", "estop"}
    assert {row.name for row in VERBS.values() if row.is_datagram} == {"stop", "estop"}


def test_viewers_may_ask_questions_alone_but_not_for_the_audit_log() -> None:
    asked = {row.name for row in VERBS.values() if row.is_for_viewers}
    assert asked == {row.name for row in VERBS.values() if not row.is_request} - {"audit"}


def test_each_verb_of_the_command_line_is_a_command_of_its_name() -> None:
    from swarmd.cli.swarmctl import VERBS as commands

    for verb, row in commands.items():
        module, _, name = row.place.partition(":")
        assert getattr(import_module(module), name).name == verb
