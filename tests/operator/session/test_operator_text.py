"""Names and reasons that cannot be sent as they are."""

from __future__ import annotations

import pytest

from swarmd.core.verbs import ResetRequest
from swarmd.link.datagram import Stop
from swarmd.link.settings import NetworkSettings
from swarmd.operator.session.operator import Operator
from swarmd.operator.session.targets import operator_name
from tests.link.conftest import Robots


def test_an_operator_name_that_is_no_utf8_is_mended(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("LOGNAME", "\udcff\udcfe" + "x" * 300)
    name = operator_name()
    assert name.startswith("??x")
    assert len(name.encode()) == 128


@pytest.mark.parametrize(
    ("reason", "kept"), [("ä" * 300, "ä" * 256), ("out\udcff of paint", "out? of paint")]
)
@pytest.mark.parametrize("verb", ["estop", "reset"])
def test_a_reason_that_cannot_be_sent_is_mended_and_never_refused(
    settings: NetworkSettings, robots: Robots, verb: str, reason: str, kept: str
) -> None:
    swarm = robots("a")
    with Operator(settings, name="\udcff" * 200) as operator:
        if verb == "reset":
            epochs = operator.members().epochs(["a"])
            outcome = operator.request(ResetRequest, epochs, reason=reason)
        else:
            outcome = operator.send_stop("estop", reason=reason)
    assert outcome.line == "1 targeted, 1 applied"
    request = swarm["a"].requests[-1]
    assert isinstance(request, Stop | ResetRequest)
    assert (request.operator, request.reason) == ("?" * 128, kept)
