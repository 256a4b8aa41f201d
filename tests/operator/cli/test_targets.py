"""Targets by name, glob and label: which robots are targets, which may be, and stops."""

from __future__ import annotations

from pathlib import Path

import click
import pytest
from msgspec.structs import replace

from swarmd.core.errors import RequestError
from swarmd.core.messages import Presence
from swarmd.link.settings import NetworkSettings
from swarmd.operator.cli.targets import read_targets
from swarmd.operator.session.exit_codes import NO_TARGET
from swarmd.operator.session.members_view import MembersView
from swarmd.operator.session.outcome import Outcome
from swarmd.operator.session.targets import (
    Targets,
    check_known,
    known_labels,
    named,
    remember,
    remembered,
    robots_of,
    stop_targets,
    unlabelled,
)
from tests.support.statuses import make_member

KNOWN = ("r1", "tb3-01", "tb3-02", "tb3-10")
LABELS = {"r1": ("red",), "r2": ("red", "fast"), "r3": ("fast",), "r4": ()}


def view(*silent: str) -> MembersView:
    """Four robots; of those in `silent` no status is known."""
    gone = {name: make_member(name, Presence.FAILED) for name in silent}
    members = {name: make_member(name, labels=labels) for name, labels in LABELS.items()} | gone
    return MembersView(members, answered=frozenset(LABELS) - set(silent))


@pytest.mark.parametrize(
    ("targets", "chosen"),
    [
        (Targets(labels=("red",)), ("r1", "r2")),
        (Targets(labels=("red", "fast")), ("r1", "r2", "r3")),
        (Targets(("r4",), labels=("fast",)), ("r2", "r3", "r4")),
        (Targets(labels=("red",), exclude=("r2",)), ("r1",)),
        (Targets(("r3", "r4")), ("r3", "r4")),
    ],
)
def test_a_robot_with_any_of_the_labels_is_a_target(
    targets: Targets, chosen: tuple[str, ...]
) -> None:
    assert robots_of(view(), targets) == chosen
    assert (
        set(stop_targets(view(), targets).matching(LABELS)) == set(chosen)
        if targets.labels
        else True
    )


def test_a_label_without_robots_is_refused_with_the_nearest() -> None:
    for resolve in (named, stop_targets):
        with pytest.raises(RequestError, match="'red'") as found:
            resolve(view(), Targets(labels=("rde",)))
        assert found.value.exit_code == NO_TARGET


def test_a_robot_without_a_status_may_have_the_label() -> None:
    seen = view("r1", "r4")
    targets = Targets(labels=("red",), exclude=("r4",))
    assert robots_of(seen, targets) == ("r2",)
    assert unlabelled(seen, targets) == ("r1",)
    assert unlabelled(seen, Targets(("r1",), labels=("red",))) == ("r4",)
    assert unlabelled(seen, Targets(("r1",))) == ()


def test_a_stop_by_label_reaches_robots_whose_labels_are_not_known() -> None:
    seen = view("r1")
    assert stop_targets(seen, Targets(labels=("fast",))).matching((*LABELS, "new")) == (
        *("new", "r1", "r2", "r3"),
    )
    # r1 may be the robot that has it.
    assert stop_targets(seen, Targets(labels=("blue",))).matching(LABELS) == ("r1",)


def test_a_stop_by_label_goes_to_all_if_no_robot_was_heard() -> None:
    assert stop_targets(MembersView({}), Targets(labels=("red",))).matching(LABELS) == tuple(LABELS)


def test_names_alone_do_not_show_labels() -> None:
    targets = Targets(labels=("red",))
    assert not targets.is_whole_swarm
    assert targets.matching(LABELS) == ()
    with pytest.raises(RequestError):
        targets.select(LABELS)


def test_an_outcome_with_unknown_labels_is_partial() -> None:
    whole = Outcome({}, missing=("r1",))
    assert whole.exit_code != 0
    from swarmd.core.messages import Code, Reply

    replies = {"r1": Reply(id="a", robot="r1", code=Code.APPLIED)}
    assert Outcome(replies).exit_code == 0
    assert Outcome(replies, unlabelled=("r2",)).exit_code == 3


def test_targets_of_a_line() -> None:
    assert read_targets("run", (), False, (), ("red",), is_required=True).labels == ("red",)
    with pytest.raises(click.UsageError):
        read_targets("run", (), False, (), ("Red",), is_required=True)
    with pytest.raises(click.UsageError):
        read_targets("run", (), True, (), ("red",), is_required=True)


def words(*names: str, exclude: tuple[str, ...] = ()) -> Targets:
    return read_targets("run", names, not names, exclude, is_required=True)


@pytest.mark.parametrize(
    ("names", "exclude", "chosen"),
    [
        ((), (), KNOWN),
        (("tb3-01",), (), ("tb3-01",)),
        (("tb3-*",), (), ("tb3-01", "tb3-02", "tb3-10")),
        (("tb3-0?", "r1"), (), ("r1", "tb3-01", "tb3-02")),
        (("tb3-[01-02]",), (), ("tb3-01", "tb3-02")),
        (("tb3-[01,10]*,r1",), (), ("r1", "tb3-01", "tb3-10")),
        (("tb3-*",), ("tb3-[01-02]",), ("tb3-10",)),
        ((), ("tb3-*",), ("r1",)),
        (("tb3-*",), ("*-01", "tb3-10"), ("tb3-02",)),
    ],
)
def test_selects_by_names_and_globs(
    names: tuple[str, ...], exclude: tuple[str, ...], chosen: tuple[str, ...]
) -> None:
    assert words(*names, exclude=exclude).select(KNOWN) == chosen


@pytest.mark.parametrize(
    ("names", "exclude", "subject"),
    [
        (("tb3-1",), (), "'tb3-10'"),
        (("x*",), (), "'x[*]'"),
        (("tb3-01", "tb3-9"), (), "'tb3-9'"),
        (("tb3-[01-03]",), (), "'tb3-03'"),
        ((), ("tb3-3",), "'tb3-3'"),
    ],
)
def test_a_name_that_matches_no_robot_is_an_error(
    names: tuple[str, ...], exclude: tuple[str, ...], subject: str
) -> None:
    with pytest.raises(RequestError, match=subject) as caught:
        words(*names, exclude=exclude).select(KNOWN)
    assert caught.value.exit_code == 4


def test_a_stop_goes_to_the_robots_that_match_and_counts_the_others() -> None:
    targets_to_stop = words("tb3-0*", "r7", exclude=("tb3-02",))
    assert targets_to_stop.matching(KNOWN) == ("tb3-01",)
    assert targets_to_stop.full_names == ("r7",)


@pytest.mark.parametrize(
    "name", ["**/x", "a/b", "r#1", "$x", "R1", "r[!1]", "r[a-c]", "", "r" * 64, "é"]
)
def test_a_word_that_could_widen_a_key_is_no_name(name: str) -> None:
    with pytest.raises(click.UsageError, match=r"robot name|the range"):
        read_targets("stop", (name,), False, (), is_required=False)


@pytest.mark.parametrize(
    ("names", "exclude", "is_whole_swarm"),
    [((), (), True), (("r1",), (), False), ((), ("r1",), False), (("*",), ("r1",), False)],
)
def test_only_targets_without_names_are_the_whole_swarm(
    names: tuple[str, ...], exclude: tuple[str, ...], is_whole_swarm: bool
) -> None:
    found = read_targets("estop", names, False, exclude, is_required=False)
    assert found.is_whole_swarm is is_whole_swarm


@pytest.mark.parametrize(
    ("name", "word"),
    [("r9", "revoked"), ("r5", "not heard"), ("q*", "no robot")],
)
def test_a_name_beside_the_roster_is_no_misspelt_one(name: str, word: str) -> None:
    """Of the roster r5 is off; r9 was revoked; no other name is proposed in their place."""
    secured = replace(view(), roster=frozenset({*LABELS, "r5"}))
    with pytest.raises(RequestError, match=word) as fault:
        check_known(name, secured.members, secured.roster)
    assert ("did you mean" in str(fault.value)) is False
    if name not in secured.roster:
        with pytest.raises(RequestError, match=word):
            robots_of(secured, Targets((name,)))
    assert robots_of(secured, Targets(("r5",))) == ("r5",)


def test_a_look_takes_and_replaces_a_damaged_cache(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    settings = NetworkSettings(swarm="meadow")
    heard = MembersView({"r1": make_member("r1", Presence.FAILED)})  # without a status, as of a run
    remember(settings, heard)
    (file,) = tmp_path.rglob("*.json")
    for damaged in (b'{"names": ["r9"], "labels": ["\xff"]}', b"\xff", b"", b"[" * 5000):
        file.write_bytes(damaged)
        assert (known_labels(settings), remembered(settings)[0]) == ([], [])
        remember(settings, heard)
        assert remembered(settings)[0] == ["r1"]
