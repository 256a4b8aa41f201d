"""The recorder of decisions goes with the mode that it stands in for."""

from __future__ import annotations

import pytest

from studies import record_decisions
from swarmd.robot.protection.modes import make_mode
from tests.support import decision_corpus as corpus


def test_a_recorded_stream_is_decided_again(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(record_decisions, "SECONDS", 8.0)
    stream = record_decisions.stream_of(record_decisions.SCENES[0], 0)
    decided = list(corpus.decided(stream, make_mode(corpus.platform_of(stream))))
    assert len(decided) >= 100
    assert all(event.twist == decision.twist for event, decision in decided)
