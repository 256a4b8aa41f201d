"""The table of verbs: each row has what answers the verb, and the rows are those of the types."""

from __future__ import annotations

from dataclasses import fields
from importlib import import_module
from typing import Any, get_args

import pytest

from swarmd.core.verbs import VERBS, AnyRequest, Handler, Request, Verb
from swarmd.daemon.incidents import IncidentService
from swarmd.daemon.pattern_transfer import PatternIntake, PatternPull
from swarmd.daemon.recording_service import RecordingService
from swarmd.daemon.requests import RequestServer, Services
from swarmd.daemon.roster_service import RosterService
from swarmd.daemon.tools import FieldTools
from swarmd.link.carriers.inbound_queue import DropCounter
from swarmd.robot.requests import RequestHandler
from tests.support.fake_services import fake_services

SERVICES = {
    Handler.PUSHES: PatternIntake,
    Handler.PUSHED: PatternPull,
    Handler.TOOLS: FieldTools,
    Handler.RECORDING: RecordingService,
    Handler.INCIDENTS: IncidentService,
    Handler.ROSTERS: RosterService,
}


def of(handler: Handler) -> list[Verb[Any, Any]]:
    return [row for row in VERBS.values() if row.handler is handler]


def test_each_type_of_request_has_a_row() -> None:
    assert {row.asked for row in VERBS.values() if row.is_request} == set(get_args(AnyRequest))
    assert {row.asked for row in of(Handler.ROBOT)} == set(get_args(Request))


def test_each_verb_of_the_robot_has_a_method() -> None:
    assert [
        row.name for row in of(Handler.ROBOT) if not hasattr(RequestHandler, f"on_{row.name}")
    ] == []


@pytest.mark.parametrize("service", SERVICES)
def test_each_verb_of_a_service_has_a_method(service: Handler) -> None:
    assert of(service)
    kind = SERVICES[service]
    assert [row.name for row in of(service) if not hasattr(kind, f"on_{row.name}")] == []


def test_a_daemon_has_each_service_of_the_table() -> None:
    assert {one for one in Handler if one.is_service} == SERVICES.keys()
    assert {one.value for one in SERVICES} == {field.name for field in fields(Services)}


def test_a_daemon_whose_service_lacks_the_method_of_a_verb_does_not_start() -> None:
    audit: Any = None
    services = fake_services(object())
    with pytest.raises(AttributeError, match="on_push"):
        RequestServer("r1", lambda request: None, audit, services, drops=DropCounter())


def test_only_stops_need_no_epoch_of_the_robot() -> None:
    assert {row.name for row in of(Handler.ROBOT) if not row.needs_epoch} == {"stop", "estop"}
    assert {row.name for row in VERBS.values() if row.is_datagram} == {"stop", "estop"}


def test_viewers_may_ask_questions_alone_but_not_for_the_audit_log_or_the_file_of_an_incident() -> (
    None
):
    asked = {row.name for row in VERBS.values() if row.is_for_viewers}
    assert asked == {row.name for row in VERBS.values() if not row.is_request} - {
        "audit",
        "incident",
    }


def test_each_verb_of_the_command_line_is_a_command_of_its_name() -> None:
    from swarmd.operator.cli.swarmctl import VERBS as commands

    for verb, row in commands.items():
        module, _, name = row.place.partition(":")
        assert getattr(import_module(module), name).name == verb
