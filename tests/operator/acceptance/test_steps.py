"""The table of steps: its order, its bounds, and what the pages say of it."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from swarmd.operator.acceptance.step import End, Step
from swarmd.operator.acceptance.steps import NOT_SHOWN_YET, PARTS, steps_of
from swarmd.settings.platforms import load_platform, platform_names

DOCS = Path(__file__).resolve().parents[3] / "docs"
STEPS = {step.id: step for step in steps_of(load_platform("burger"))}
BRAKE = 1.0  # s at full speed: delay and braking of a sound base


@pytest.mark.parametrize("platform", platform_names())
def test_each_platform_has_steps_whose_runs_fit_into_their_bounds(platform: str) -> None:
    for step in steps_of(load_platform(platform)):
        motion = step.motion
        if motion is None or motion.pattern != "drive":
            continue
        speed = abs(motion.params["speed"])
        assert speed <= motion.speed
        assert speed * (motion.seconds + BRAKE) <= motion.stop_at + 1e-9, step.id
        assert motion.params["recovery"] is False


def test_ids_are_counted_by_part_in_their_order() -> None:
    ids = list(STEPS)
    for part in PARTS:
        own = [id for id in ids if id.startswith(part)]
        assert own == [f"{part}{number}" for number in range(1, len(own) + 1)]
    assert "".join(dict.fromkeys(id[0] for id in ids)) == "ABCD"


def test_what_a_step_needs_comes_before_it() -> None:
    ids = list(STEPS)
    for step in STEPS.values():
        for needed in (*step.needs, *filter(None, [step.of])):
            assert ids.index(needed) < ids.index(step.id)


def needs_a_base_that_obeys(step: Step) -> bool:
    return "B1" in step.needs or any(needs_a_base_that_obeys(STEPS[one]) for one in step.needs)


def test_nothing_drives_on_the_floor_before_the_base_has_obeyed_a_stop() -> None:
    moving = [step for step in STEPS.values() if step.motion is not None and step.id != "B1"]
    assert len(moving) == 22
    assert all(needs_a_base_that_obeys(step) for step in moving)
    first = STEPS["B1"].motion
    assert first is not None
    assert (first.is_lifted, first.end) == (True, End.STOP)


def test_each_motion_is_asked_for_and_each_reason_is_one_sentence() -> None:
    for step in STEPS.values():
        assert (step.motion is None) or step.question.endswith("?")
        assert re.fullmatch(r"[^.]*( --check)?[^.]*\.", step.why), step.why


def test_each_row_of_what_is_not_shown_names_its_step() -> None:
    page = (DOCS / "robots" / "new_robot.md").read_text()
    table = page[page.index("| not shown | step |") :].splitlines()[2:]
    rows = [tuple(cell.strip() for cell in line.strip("|").split("|")[:2]) for line in table]
    assert len(rows) > 8
    assert sorted(rows) == sorted(
        (text, id) for id, texts in NOT_SHOWN_YET.items() for text in texts
    )
    assert NOT_SHOWN_YET.keys() <= STEPS.keys()


def test_the_page_has_all_parts() -> None:
    page = (DOCS / "acceptance.md").read_text()
    assert all(f"| {part}: {words}" in page for part, words in PARTS.items())
