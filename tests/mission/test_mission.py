"""What missions do, step by step."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import msgspec
import pytest

from swarmd.core.errors import ConfigError
from swarmd.core.values import Inputs, Message, Outputs, Twist
from swarmd.kit.behavior import Pattern
from swarmd.kit.params import Params, schema
from tests.support.mission_parts import PLATFORM, Brief, Vote, made, mission_of, steps

PARTS = """
mission: Tried out
parts:
  vote: {pattern: vote_on, params: {initial: 1}}
  go: {pattern: go}
  other: {pattern: go, params: {speed: 0.9}}
  brief: {pattern: brief}
"""


def parts(*names: str) -> str:
    """The head of a mission with these parts."""
    lines = PARTS.strip().splitlines()
    kept = [line for line in lines[2:] if line.strip().split(":")[0] in names]
    return "\n".join([*lines[:2], *kept]) + "\n"


def speeds(found: list[Outputs]) -> list[float | None]:
    return [None if one.twist is None else one.twist.linear for one in found]


def test_steps_of_a_sequence_follow_each_other_and_parts_keep_their_memory(tmp_path: Path) -> None:
    text = parts("go", "other") + (
        "sequence: [{part: go, until: {timeout: 2}}, {part: other, until: {timeout: 1}}]\n"
        "then: repeat\n"
    )
    found = steps(made(tmp_path, text), 10.0, 11.9, 12.0, 12.9, 13.0)
    assert speeds(found) == [0.2, 0.2, 0.9, 0.9, 0.2]
    assert [one.report["phase"] for one in found] == ["go", "go", "other", "other", "go"]
    assert found[-1].report["go.steps"] == 3
    assert "other.steps" not in found[-1].report


def test_reports_have_the_units_of_the_parts(tmp_path: Path) -> None:
    root = (
        parts("vote", "go")
        + "sequence: [{part: go, until: {timeout: 2}}, {part: vote}]\nthen: stay\n"
    )
    assert mission_of(tmp_path, root).report_units == {"go.steps": "steps"}
    text = root + "report: {count: go.steps, pace: go.speed, opinion: vote.opinion}\n"
    assert mission_of(tmp_path, text).report_units == {"count": "steps", "pace": "m/s"}


def test_an_old_report_does_not_end_a_repeated_step(tmp_path: Path) -> None:
    text = parts("go", "other") + (
        "sequence:\n  - {part: go, until: {report: go.steps, above: 0}}\n"
        "  - {part: other, until: {timeout: 1}}\nthen: repeat\n"
    )
    found = steps(made(tmp_path, text), 0.0, 0.1, 0.5, 1.1, 1.2, 1.3, 2.2)
    phases = [one.report["phase"] for one in found]
    assert phases == ["go", "other", "other", "go", "other", "other", "go"]
    assert [one.report.get("go.steps") for one in found] == [1, None, None, 2, None, None, 3]


def test_a_mission_ends_after_its_last_step_with_a_reason(tmp_path: Path) -> None:
    text = parts("go") + "sequence: [{part: go, until: {nearer: 0.5}}]\nthen: end\n"
    mission = made(tmp_path, text)
    assert [one.done for one in steps(mission, 0.0, 1.0)] == [None, None]
    (last,) = steps(mission, 2.0, range_=0.4)
    assert last.done == "something is nearer than 0.5 m"
    assert last.twist is None


def test_a_step_whose_part_is_done_ends(tmp_path: Path) -> None:
    text = parts("brief", "go") + (
        "sequence: [{part: brief, until: {timeout: 100}}, go]\nthen: stay\n"
    )
    found = steps(made(tmp_path, text), *range(6))
    assert speeds(found) == [0.5, 0.5, 0.5, 0.2, 0.2, 0.2]
    assert [one.done for one in found] == [None] * 6


def test_a_last_step_that_is_done_ends_the_mission_in_that_step(tmp_path: Path) -> None:
    text = parts("brief") + "sequence: [{part: brief, until: {done: brief}}]\nthen: end\n"
    found = steps(made(tmp_path, text), *range(3))
    assert [one.done for one in found] == [None, None, "brief: three steps"]


def test_in_a_parallel_one_drives_and_all_send_messages(tmp_path: Path) -> None:
    text = parts("vote", "brief", "go") + "parallel: [vote, brief, go]\ndrives: go\n"
    found = steps(made(tmp_path, text), *range(5))
    assert speeds(found) == [0.2] * 5
    assert found[0].messages["brief/count"] == 1
    assert "vote_on/opinion" in found[0].messages
    # Who is done is not stepped any more, and the others go on.
    assert [one.report.get("brief.count") for one in found] == [1, 2, 3, None, None]
    assert found[4].report["go.steps"] == 5


def test_a_parallel_without_drives_sends_no_command(tmp_path: Path) -> None:
    text = parts("vote", "go") + "parallel: [vote, go]\ndrives: none\n"
    assert speeds(steps(made(tmp_path, text), 0.0, 1.0)) == [None, None]


def test_a_parallel_ends_when_all_items_have_ended(tmp_path: Path) -> None:
    text = parts("brief", "go") + (
        "parallel: [{part: go, until: {timeout: 1}}, {part: brief, until: {done: brief}}]\n"
        "drives: go\n"
    )
    found = steps(made(tmp_path, text), 0.0, 0.9, 1.0)
    assert speeds(found) == [0.2, 0.2, None]
    assert found[2].done == "1 s have passed; brief: three steps"


def test_a_switch_takes_the_first_branch_whose_condition_holds(tmp_path: Path) -> None:
    text = parts("go", "other") + (
        "switch:\n  - {when: {nearer: 1.0}, part: other, name: close}\n  - {part: go}\n"
    )
    mission = made(tmp_path, text)
    assert speeds(steps(mission, 0.0)) == [0.2]
    close = steps(mission, 1.0, range_=0.9)
    assert speeds(close) == [0.9]
    assert close[0].report["phase"] == "close"
    assert speeds(steps(mission, 2.0)) == [0.2]


def test_a_switch_without_a_branch_sends_no_command(tmp_path: Path) -> None:
    text = parts("go") + "switch: [{when: {reading: light, above: 2}, part: go}]\n"
    kind = mission_of(tmp_path, text)
    assert kind.needs == {"scan", "reading:light"}
    platform = replace(PLATFORM, provides=PLATFORM.provides | {"reading:light"})
    mission = made(tmp_path, text, platform)
    assert speeds(steps(mission, 0.0)) == [None]
    assert speeds(steps(mission, 1.0, readings={"light": 3.0})) == [0.2]


MAPPED = parts("vote", "go") + (
    "map: [{from: vote.opinion, to: go.speed, values: [0.3, 0.5, 0.7]}]\n"
    "parallel: [vote, go]\ndrives: go\nreport: {opinion: vote.opinion, speed: go.speed}\n"
)


def test_a_map_sets_a_parameter_by_a_report(tmp_path: Path) -> None:
    mission = made(tmp_path, MAPPED)
    (first,) = steps(mission, 0.0)
    assert first.twist == Twist(0.5)
    assert first.report == {"phase": "vote+go", "opinion": 1, "speed": 0.5}
    mission.parts["vote"].opinion = 2  # type: ignore[attr-defined]
    assert speeds(steps(mission, 1.0)) == [0.7]


def test_a_map_may_be_a_base_and_a_step(tmp_path: Path) -> None:
    mission = made(tmp_path, MAPPED.replace("values: [0.3, 0.5, 0.7]", "base: 0.1, step: 0.2"))
    assert speeds(steps(mission, 0.0)) == [pytest.approx(0.3)]


def test_channels_are_those_of_the_pattern_unless_private(tmp_path: Path) -> None:
    text = parts("vote").replace("initial: 1}", "initial: 1}, private: true") + "part: vote\n"
    mission = made(tmp_path, text)
    assert set(mission.channels) == {f"vote-{name}" for name in ("opinion", "round_vote")} & set(
        mission.channels
    )
    said = Message("robot-2", "vote-opinion", 0, 0.0)
    outputs = mission.step(Inputs(0.0, 0.0, messages=(said,)))
    assert outputs.messages["vote-opinion"] == 1


def test_own_parameters_are_those_of_parts_with_their_bounds(tmp_path: Path) -> None:
    text = parts("go") + "part: go\nparameters: {fast: go.speed}\n"
    kind = mission_of(tmp_path, text)
    spec = {one.name: one for one in schema(kind.params_type)}
    assert (spec["fast"].le, spec["fast"].unit) == (1.0, "m/s")
    assert kind.defaults(PLATFORM) == {"fast": 0.2}
    mission = made(tmp_path, text, fast=0.4)
    assert speeds(steps(mission, 0.0)) == [0.4]
    mission.update(msgspec.structs.replace(mission.params, fast=0.6))
    assert speeds(steps(mission, 1.0)) == [0.6]
    with pytest.raises(ConfigError, match="fast is 3"):
        made(tmp_path, text, fast=3)


def test_a_change_that_breaks_a_map_value_is_refused(tmp_path: Path) -> None:
    text = parts("vote", "brief") + (
        "map: [{from: brief.count, to: vote.share_period, values: {a: 1.0, b: 2.4}}]\n"
        "parallel: [vote, brief]\ndrives: brief\nparameters: {expiry: vote.expiry}\n"
    )
    mission = made(tmp_path, text)
    mission.update(msgspec.structs.replace(mission.params, expiry=2.5))
    with pytest.raises(ConfigError, match=r"yaml:5: .* 2\.4 .* expiry is 2 s"):
        mission.update(msgspec.structs.replace(mission.params, expiry=2.0))
    assert mission.parts["vote"].params.expiry == 2.5


@pytest.mark.parametrize("now", ["", "- ["])
def test_a_refusal_at_run_time_does_not_need_the_file(tmp_path: Path, now: str) -> None:
    mission = made(tmp_path, MAPPED + "parameters: {opinions: vote.opinions}\n")
    path = tmp_path / "tried.yaml"
    if now:
        path.write_text(now)
    else:
        path.unlink()
    with pytest.raises(ConfigError, match="no value for opinion 3"):
        mission.update(msgspec.structs.replace(mission.params, opinions=4))


GO = parts("go") + "part: go\n"


@pytest.mark.parametrize(
    ("text", "wanted"),
    [
        (parts("vote", "go") + "parallel: [vote, go]\ndrives: go\n", True),
        (GO + "recovery: false\n", False),
        (GO.replace("pattern: go}", "pattern: go, params: {recovery: false}}"), False),
        (parts("vote") + "part: vote\n", False),
    ],
)
def test_recovery_defaults_to_that_of_driving_parts(
    tmp_path: Path, text: str, wanted: bool
) -> None:
    assert made(tmp_path, text).params.recovery is wanted


def test_a_repeating_sequence_continues_after_a_done_part(tmp_path: Path) -> None:
    text = parts("brief") + "sequence: [{part: brief, until: {timeout: 9}}]\nthen: repeat\n"
    found = steps(made(tmp_path, text), 0.0, 0.1, 0.2, 0.3, 0.4)
    assert [one.done for one in found] == [None] * 5
    assert [one.report["brief.count"] for one in found] == [1, 2, 3, 4, 5]


def test_a_branch_restarts_when_chosen_and_rests_when_ended(tmp_path: Path) -> None:
    text = parts("go", "other") + (
        "switch: [{when: {nearer: 0.5}, part: go, until: {timeout: 1}}, other]\n"
    )
    mission = made(tmp_path, text)
    for begin in (100.0, 200.0):
        near = steps(mission, begin, begin + 0.9, begin + 1.0, begin + 5.0, range_=0.4)
        assert speeds(near) == [0.2, 0.2, None, None]
        assert speeds(steps(mission, begin + 6.0)) == [0.9]


def test_times_of_inner_elements_count_from_their_start(tmp_path: Path) -> None:
    text = parts("vote", "go", "other") + (
        "sequence:\n  - {part: vote, until: {timeout: 5}}\n"
        "  - {parallel: [{part: go, until: {timeout: 2}}, vote], drives: go, until: {timeout: 3}}\n"
        "  - {switch: [{when: {timeout: 2}, part: other}, {part: go}]}\nthen: stay\n"
    )
    found = steps(made(tmp_path, text), 100.0, 105.0, 106.9, 107.0, 108.0, 109.9, 110.0)
    assert speeds(found) == [None, 0.2, 0.2, None, 0.2, 0.2, 0.9]


def test_its_rate_is_that_of_its_fastest_part(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(Brief, "rate", 25.0)
    text = parts("go", "brief") + "parallel: [go, brief]\ndrives: go\n"
    assert mission_of(tmp_path, text).rate == 25.0


def test_a_map_value_that_only_update_refuses_is_a_fault(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def refuse(self: Pattern[Params], params: Params) -> None:
        raise ConfigError("not while it runs")

    monkeypatch.setattr(Vote, "update", refuse)
    text = parts("vote", "brief") + (
        "map: [{from: brief.count, to: vote.window, values: {a: 1.0}}]\n"
        "parallel: [vote, brief]\ndrives: brief\n"
    )
    with pytest.raises(ConfigError, match=r"yaml:5: .* vote\.window to 1\.0"):
        made(tmp_path, text)


LOST = "fails: {nearer: 0.5}"


def phases(found: list[Outputs]) -> list[object]:
    return [one.report["phase"] for one in found]


def test_a_fallback_goes_on_where_an_item_fails_and_ends_with_the_first_that_ends(
    tmp_path: Path,
) -> None:
    text = parts("go", "brief") + f"fallback: [{{part: go, {LOST}}}, brief]\n"
    mission = made(tmp_path, text)
    assert phases(steps(mission, 0.0, 1.0)) == ["go", "go"]
    assert phases(steps(mission, 2.0, 3.0, range_=0.4)) == ["brief", "brief"]
    (last,) = steps(mission, 4.0)
    assert last.done == "brief: three steps"
    mission = made(tmp_path, parts("go", "brief") + f"fallback: [{{part: brief, {LOST}}}, go]\n")
    assert [one.done for one in steps(mission, 0.0, 1.0, 2.0)][-1] == "brief: three steps"


def test_a_mission_whose_last_resort_fails_ends_and_says_so(tmp_path: Path) -> None:
    text = parts("go", "other") + f"fallback: [{{part: go, {LOST}}}, {{part: other, {LOST}}}]\n"
    found = steps(made(tmp_path, text), *range(3), range_=0.4)
    assert phases(found) == ["go", "other", "other"]
    assert [one.done for one in found] == [None, None, "failed: something is nearer than 0.5 m"]


def test_a_failed_step_fails_its_sequence_which_is_tried_again_so_many_times(
    tmp_path: Path,
) -> None:
    text = parts("go", "other") + (
        f"sequence: [{{part: go, until: {{timeout: 1}}}}, {{part: other, {LOST}}}]\n"
        "then: stay\nretry: 2\n"
    )
    found = steps(made(tmp_path, text), *range(10), range_=0.4)
    assert phases(found)[:8] == ["go", "other", "go", "go", "other", "go", "go", "other"]
    assert [one.done for one in found].index("failed: something is nearer than 0.5 m") == 8
    assert not any(one.done for one in found[:8])


def test_an_element_that_is_tried_again_begins_its_times_anew(tmp_path: Path) -> None:
    text = parts("go") + f"part: go\n{LOST}\nretry: 1\nuntil: {{timeout: 1.5}}\n"
    mission = made(tmp_path, text)
    steps(mission, 0.0)
    assert steps(mission, 1.0, range_=0.4)[0].done is None
    assert steps(mission, 3.0)[0].done == "1.5 s have passed"


def test_an_item_that_fails_fails_its_parallel_and_a_branch_its_switch(tmp_path: Path) -> None:
    both = f"parallel: [{{part: go, {LOST}}}, other]\ndrives: other\n"
    branch = f"switch: [{{part: go, {LOST}}}]\n"
    for text in (parts("go", "other") + both, parts("go") + branch):
        found = steps(made(tmp_path, text), 0.0, 1.0, range_=0.4)
        assert [one.done for one in found] == [None, "failed: something is nearer than 0.5 m"]


@pytest.mark.parametrize("condition", ["report: go.steps, above: 1", "done: brief"])
def test_a_retry_does_not_fail_by_what_its_parts_reported_before(
    tmp_path: Path, condition: str
) -> None:
    last = "brief" if "brief" in condition else "go"
    text = parts("other", last) + (
        "sequence: [{part: other, until: {timeout: 1}}, "
        f"{{part: {last}, until: {{timeout: 9}}}}]\n"
        f"then: repeat\nfails: {{{condition}}}\nretry: 1\n"
    )
    found = steps(made(tmp_path, text), *(0.5 * index for index in range(8)))
    again = [one.report["phase"] for one in found].index("other", 2)
    assert [one.report["phase"] for one in found[again : again + 2]] == ["other", "other"]
    assert found[again + 2].report["phase"] == last
    assert [one.done for one in found[: again + 3]] == [None] * (again + 3)


MACHINE = parts("go", "other", "brief") + (
    "sequence:\n"
    "  - {part: go, transitions: {brief: {nearer: 0.5}, far: {nearer: 1.0}}}\n"
    "  - {part: other, name: far, transitions: {go: {timeout: 2}}}\n"
    "  - {part: brief, transitions: {far: {timeout: 9}}, until: {timeout: 5}}\n"
    "then: repeat\n"
)


def test_a_transition_leads_to_the_step_that_it_names_the_first_that_holds(tmp_path: Path) -> None:
    mission = made(tmp_path, MACHINE)
    assert phases(steps(mission, 0.0, 1.0)) == ["go", "go"]
    # Both hold at 2 s; the times of far count from there.
    assert phases(steps(mission, 2.0, range_=0.4)) == ["brief"]
    assert phases(steps(mission, 3.0, 4.0, range_=0.4)) == ["brief", "brief"]
    # The part of brief is done: the step after it follows, and the last is followed by the first.
    assert phases(steps(mission, 5.0)) == ["go"]
    assert phases(steps(mission, 6.0, range_=0.9)) == ["far"]
    assert phases(steps(mission, 7.9, 8.0)) == ["far", "go"]


def test_a_transition_is_not_taken_in_the_first_step_of_its_step(tmp_path: Path) -> None:
    mission = made(tmp_path, MACHINE)
    assert phases(steps(mission, 0.0, 0.1, range_=0.9)) == ["go", "far"]


def test_an_until_precedes_a_transition(tmp_path: Path) -> None:
    text = parts("go", "other", "brief") + (
        "sequence:\n"
        "  - {part: go, until: {timeout: 1}, transitions: {brief: {timeout: 1}}}\n"
        "  - {part: other, until: {timeout: 1}}\n  - brief\nthen: stay\n"
    )
    assert phases(steps(made(tmp_path, text), 0.0, 1.0)) == ["go", "other"]


DRAWN = parts("go", "other") + (
    "sequence:\n  - {part: go, until: {probability: 0.3}}\n"
    "  - {part: other, transitions: {go: {probability: 0.3}}}\nthen: repeat\n"
)


def test_draws_follow_from_the_seed_of_the_robot_and_leave_its_parts_alone(tmp_path: Path) -> None:
    times = [0.1 * index for index in range(300)]
    first, again, other = (made(tmp_path, DRAWN, seed=seed) for seed in (5, 5, 6))
    found = [phases(steps(one, *times)) for one in (first, again, other)]
    assert found[0] == found[1] != found[2]
    assert {*found[0]} == {"go", "other"}
    spawned = [one.parts["go"].context.rng.random() for one in (first, made(tmp_path, GO, seed=5))]
    assert spawned[0] == spawned[1]
