"""Values over time, and moments of the past."""

from __future__ import annotations

import json
import math
from typing import Any

import numpy as np
import pytest

from swarmd.operator.view.history import MAX_KEYS, History, Moment, Survey, measured, plots_of
from swarmd.operator.view.playback import Playback
from tests.operator.view.test_server import OneRobot


def places(*where: tuple[float, float]) -> Any:
    return np.array([(i, x, y, 0.0) for i, (x, y) in enumerate(where)]).reshape(-1, 4)


@pytest.mark.parametrize(
    ("where", "count"),
    [([(0, 0), (1, 0), (2, 0)], 1), ([(0, 0), (3, 0), (1, 0), (2.5, 0)], 2), ([(0, 0)], 1)],
)
def test_clusters_are_chains_of_near_robots(where: list[tuple[float, float]], count: int) -> None:
    now = places(*where)
    assert measured(now, now, 1.0, {}, 1.1)["clusters"] == count
    assert "clusters" not in measured(now, now, 1.0, {}, None)


def test_speed_is_that_of_robots_that_are_known_at_both_times() -> None:
    now, before = places((1.0, 0.0), (0.0, 0.5), (9.0, 9.0)), places((0.0, 0.0), (0.0, 0.0))
    assert measured(now, before, 2.0, {}, None)["speed"] == pytest.approx(0.375)
    assert "speed" not in measured(places(), before, 2.0, {}, None)


def test_shares_and_means_of_rows() -> None:
    rows: dict[str, dict[str, Any]] = {
        "a": {"state": "running", "protection": "active", "report": {"opinion": "A", "votes": 2}},
        "b": {"state": "running", "protection": "clear", "report": {"opinion": "A", "votes": 4}},
        "gone": {"state": "running", "protection": "active", "presence": "failed"},
        "c": {"state": "estopped", "protection": "", "report": {"opinion": "B"}},
        "d": {"state": "", "readings": {"battery": math.nan}},
    }
    found = measured(places(), places(), 1.0, rows, None)
    assert found["active"] == 0.5
    assert found["report:votes"] == 3.0
    assert found["report:opinion"] == pytest.approx(2 / 3)
    assert "readings:battery" not in found


def test_a_robot_that_reports_much_does_not_fill_the_plots() -> None:
    rows = {"a": {"report": {f"k{i}": i for i in range(10 * MAX_KEYS)}}}
    assert len(measured(places(), places(), 1.0, rows, None)) == MAX_KEYS


def test_a_robot_that_reports_under_other_names_each_second_does_not_fill_the_plots() -> None:
    moments = [
        Moment(
            float(at),
            {"active": 1.0, **{f"report:k{at}-{i}": 1.0 for i in range(MAX_KEYS)}},
            b"",
            b"",
        )
        for at in range(300)
    ]
    moments.append(Moment(300.0, {"report:now": 1.0}, b"", b""))
    values = plots_of(moments, 0)["values"]
    assert len(values) <= 3 + MAX_KEYS
    assert {"active", "report:now", "report:k299-0"} <= values.keys()


def test_moments_are_kept_and_found_by_time() -> None:
    now = [0.0]
    history = History(OneRobot(), lambda: now[0])
    assert history.at(0.0) is None
    for second in range(400):
        history.advance(second)
        history.advance(second)  # not due
        now[0] += 1.0
    count, message = history.since(0)
    assert count == 400
    assert message is not None
    assert message["first"] == 100
    assert len(message["times"]) == 300
    assert history.since(count) == (count, None)
    moment = history.at(message["times"][50] + 0.5)
    assert moment is not None
    assert moment.time == message["times"][50]
    assert int.from_bytes(moment.frame[4:8], "little") == 150  # the number that pages quote
    assert json.loads(moment.text)["rows"]["r1"]["near"] is None
    oldest = history.at(-1e9)
    assert oldest is not None
    assert oldest.time == message["times"][0]


def test_a_recorded_run_is_surveyed_whole_and_its_time_stays(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr("swarmd.operator.view.history.SURVEY_TIME", 0.0)  # a moment at a time
    source: Any = OneRobot()
    source.playback = Playback(["one"], lambda _: None, lambda: 0.0)
    source.playback.load("one", 60.0)
    survey = Survey(source)
    count = -1
    while count < (count := survey.since(0)[0]):
        survey.advance(0)
    _, message = survey.since(0)
    assert message is not None
    assert (message["times"][0], message["times"][-1]) == (0.0, 60.0)
    assert source.playback.time == 0.0
    source.playback.load("other", 6.0)
    source.playback.run = "other"
    survey.advance(0)
    while survey.since(0)[0] < 2 * count:  # as many moments as those of the first run
        survey.advance(0)
    shorter = survey.since(count)[1]
    assert shorter is not None
    assert shorter["first"] == 0
