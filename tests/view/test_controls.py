"""What keys choose and command at a terminal."""

from __future__ import annotations

import pytest

from swarmd.view.controls import HELP, Command, Controls, Mode
from swarmd.view.screen import PASTED

ROWS = {"a1": "idle never_asked", "a2": "running drive", "b1": "estopped estop"}


def press(controls: Controls, *keys: str) -> list[Command]:
    """The commands of some keys; the robots that pass the filter are looked up before each."""
    commands = []
    for key in keys:
        robots = controls.shown(ROWS)
        controls.follow(robots)
        if command := controls.on_key(key, robots, tuple(ROWS)):
            commands.append(command)
    controls.follow(controls.shown(ROWS))
    return commands


def test_run_goes_to_the_selected_robots_with_the_typed_pattern() -> None:
    controls = Controls(patterns=("attraction", "avoid", "drive"))
    commands = press(controls, "space", "space", "r", *"dr", "tab", *"x=1", "enter")
    expected = Command("run", ("a1", "a2"), {"pattern": "drive", "params": "x=1"})
    assert commands == [expected]
    assert controls.mode is Mode.LOOK


def test_run_goes_to_the_robot_at_the_cursor_if_none_is_selected() -> None:
    assert press(Controls(), "down", "r", *"drive", "enter")[0].targets == ("a2",)


def test_run_without_a_pattern_or_after_escape_sends_nothing() -> None:
    assert press(Controls(), "r", "enter", "r", *"drive", "escape") == []


def test_tab_completes_what_all_matching_patterns_share() -> None:
    controls = Controls(patterns=("attraction", "attractor"))
    press(controls, "r", "a", "tab")
    assert controls.text == "attract"


@pytest.mark.parametrize(
    "before",
    [(), ("space",), ("/",), ("r", "d"), ("x",), ("?",)],
    ids=["look", "selected", "filter", "run", "reset", "help"],
)
def test_an_estop_of_all_takes_one_key_at_any_time(before: tuple[str, ...]) -> None:
    assert press(Controls(), *before, "ctrl-e") == [Command("estop")]


@pytest.mark.parametrize("before", [(), ("space",), ("x",)])
@pytest.mark.parametrize("key", ["e", "E"])
def test_the_letter_is_an_estop_where_no_text_is_typed(before: tuple[str, ...], key: str) -> None:
    assert press(Controls(), *before, key) == [Command("estop")]


def test_stop_goes_to_the_selected_robots_or_to_all() -> None:
    assert press(Controls(), "s") == [Command("stop")]
    assert press(Controls(), "space", "s") == [Command("stop", ("a1",))]


def test_reset_asks() -> None:
    assert press(Controls(), "x", "n") == []
    assert press(Controls(), "x", "enter") == []
    assert press(Controls(), "a", "x", "y") == [Command("reset", ("a1", "a2", "b1"))]


def test_filter_narrows_what_all_selects_and_escape_ends_it() -> None:
    controls = Controls()
    press(controls, "/", *"run", "enter", "a", "escape")
    assert controls.selected == {"a2"}
    assert controls.shown(ROWS) == tuple(ROWS)


@pytest.mark.parametrize(("text", "robots"), [("a*", ("a1", "a2")), ("ESTOP", ("b1",))])
def test_filter_takes_globs_of_names_and_parts_of_a_row(text: str, robots: tuple[str, ...]) -> None:
    controls = Controls()
    press(controls, "/", *text)
    assert controls.shown(ROWS) == robots


def test_a_again_selects_none() -> None:
    controls = Controls()
    press(controls, "a", "a")
    assert controls.selected == set()


def test_pasted_text_is_text_and_never_a_command() -> None:
    controls = Controls()
    assert press(controls, f"{PASTED}r drive\n") == []
    assert press(controls, "r", f"{PASTED}dri\nve e") == []
    assert controls.text == "drive e"


def test_the_cursor_stays_near_its_place_when_its_robot_vanishes() -> None:
    controls = Controls(cursor="a2")
    controls.follow(("a1", "b1"), before=("a1", "a2", "b1"))
    assert controls.cursor == "b1"
    controls.follow(())
    assert controls.cursor == ""


def test_a_terminal_of_40_columns_has_the_estop_in_its_help() -> None:
    assert HELP[:40].startswith("e ESTOP  s stop")
