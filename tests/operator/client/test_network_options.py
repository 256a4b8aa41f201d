"""A stop while files that swarmctl may read are broken, in turn: what is sent, with whose keys.

A row says which of three happens: `applied`; `told`, that is applied with a warning; `refused`, in
one line with the command that works.
"""

from __future__ import annotations

import errno
import os
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, Literal, Self, TypeAlias

import pytest

import swarmd
from swarmd.core.errors import ConfigError
from swarmd.core.messages import Code, Reply
from swarmd.link.keys.identity import INFO, KEY, ROSTER, Identity
from swarmd.link.settings import NetworkSettings
from swarmd.operator.session import operator as operator_module
from swarmd.operator.session.members_view import MembersView
from swarmd.operator.session.outcome import Outcome
from swarmd.settings.contexts import Context, Contexts, add_context, contexts_path, save_contexts
from tests.support.keys import SwarmKeys
from tests.support.swarmctl import swarmctl

Result: TypeAlias = Literal["applied", "told", "refused"]
Break: TypeAlias = Callable[[Path, pytest.MonkeyPatch], object]
"""Breaks files below the home of the user."""

MEADOW = ("--swarm", "meadow")
CONFIG = Path(".config/swarmd")
CONTEXTS = CONFIG / "contexts.yaml"
KEYS = CONFIG / "identities/meadow"


class Sending:
    """An operator that keeps its stops; the only robot is r1, with or without keys."""

    sent: list[tuple[str, str, str | None]]
    """Swarm, profile and the name in the keys of each stop."""
    has_keys: bool
    """Whether the robot has keys, so that no operator without keys hears it."""

    def __init__(
        self, settings: NetworkSettings, *, identity: Identity | None = None, roster: Any = ()
    ) -> None:
        self.settings, self.identity = settings, identity
        self.notices = list[str]()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *error: object) -> None:
        self.close()

    def close(self) -> None:
        pass

    def _heard(self) -> MembersView:
        is_heard = self.has_keys == (self.identity is not None)
        members: Any = {"r1": object()} if is_heard else {}
        return MembersView(members)

    def members(self, **_: object) -> MembersView:
        return self._heard()

    def seen(self) -> MembersView:
        return self._heard()

    def update_roster(self) -> None:
        pass

    def send_stop(self, verb: str, **_: object) -> Outcome:
        name = None if self.identity is None else self.identity.name
        self.sent.append((self.settings.swarm, self.settings.profile, name))
        return Outcome({"r1": Reply(id="s", robot="r1", code=Code.APPLIED)})


@pytest.fixture
def sending(monkeypatch: pytest.MonkeyPatch) -> type[Sending]:
    """Takes the place of the operator."""
    monkeypatch.setattr(operator_module, "Operator", Sending)
    monkeypatch.setattr(Sending, "sent", [], raising=False)
    monkeypatch.setattr(Sending, "has_keys", False, raising=False)
    return Sending


@pytest.fixture
def home(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    """A home whose context in use is of swarm meadow; the environment names no swarm."""
    variables = ("SWARM", "SWARM_CONFIG", "SWARM_CONTEXT", "XDG_CONFIG_HOME", "XDG_CACHE_HOME")
    for name in variables:
        monkeypatch.delenv(name, raising=False)
    monkeypatch.setenv("HOME", str(tmp_path))
    add_context("lab", Context(swarm="meadow"), use=True)
    yield tmp_path
    monkeypatch.undo()  # before pytest removes the folder


@pytest.fixture(scope="module")
def keys(tmp_path_factory: pytest.TempPathFactory) -> SwarmKeys:
    return SwarmKeys(tmp_path_factory.mktemp("keys"), "meadow", ["r1"], operators=["alice"])


def deny(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Let this user read nothing in a folder, nor the file of that path; root ignores modes."""

    def denied(real: Callable[..., Any], *, is_inside: bool) -> Callable[..., Any]:
        def call(path: Any, *args: Any, **kwargs: Any) -> Any:
            name = os.fspath(path) if isinstance(path, str | Path) else ""
            if name.startswith(f"{folder}/") or (not is_inside and name == str(folder)):
                raise PermissionError(errno.EACCES, os.strerror(errno.EACCES), name)
            return real(path, *args, **kwargs)

        return call

    for name in ("open", "listdir"):
        monkeypatch.setattr(os, name, denied(getattr(os, name), is_inside=False))
    for name in ("stat", "lstat"):
        monkeypatch.setattr(os, name, denied(getattr(os, name), is_inside=True))


def written(path: Path, content: bytes) -> Break:
    """A file gets this content, and its folder is made."""

    def write(home: Path, monkeypatch: pytest.MonkeyPatch) -> None:
        (home / path).parent.mkdir(parents=True, exist_ok=True)
        (home / path).write_bytes(content)

    return write


def unreadable(path: Path) -> Break:
    """Another user owns a file or folder."""
    return lambda home, monkeypatch: deny(home / path, monkeypatch)


def a_folder(path: Path) -> Break:
    """A folder is in the place of a file."""

    def make(home: Path, monkeypatch: pytest.MonkeyPatch) -> None:
        (home / path).unlink(missing_ok=True)
        (home / path).mkdir(parents=True)

    return make


def leading_nowhere(path: Path) -> Break:
    """A link leads to a drive that is not mounted."""

    def link(home: Path, monkeypatch: pytest.MonkeyPatch) -> None:
        (home / path).parent.mkdir(parents=True, exist_ok=True)
        (home / path).unlink(missing_ok=True)
        (home / path).symlink_to("/nonexistent/drive")

    return link


def moved_away(folder: Path) -> Break:
    """A folder is a link to a drive that is not mounted."""

    def move(home: Path, monkeypatch: pytest.MonkeyPatch) -> None:
        (home / folder).rename(home / "drive")
        leading_nowhere(folder)(home, monkeypatch)

    return move


def with_variable(name: str, value: str | None, *then: Break) -> Break:
    """A variable of the environment is set or unset; `{home}` in it is the home."""

    def set_it(home: Path, monkeypatch: pytest.MonkeyPatch) -> None:
        for one in then:
            one(home, monkeypatch)
        if value is None:
            monkeypatch.delenv(name)
        else:
            monkeypatch.setenv(name, value.format(home=home))

    return set_it


CUT = b"use: lab\n"
NEWER = b"use: lab\ncontexts:\n  lab: {swarm: meadow, profile: field, interface: lo, relay: 3}\n"
NEWER_OUTSIDE = b"use: lab\nversion: 7\ncontexts:\n  lab: {swarm: meadow}\n"
BAD_YAML = b"swarm: [meadow\n"
SWARM_YAML = Path("swarm.yaml")

BROKEN: dict[str, tuple[Break, Result]] = {
    "contexts cut off": (written(CONTEXTS, CUT), "told"),
    "contexts cut off in a name": (written(CONTEXTS, b"use: lab\ncontexts: {la"), "told"),
    "contexts empty": (written(CONTEXTS, b""), "told"),
    "contexts of zeros": (written(CONTEXTS, bytes(64)), "told"),
    "contexts with bytes": (written(CONTEXTS, b"\xff\xfe\x00use"), "told"),
    "contexts of a newer version": (written(CONTEXTS, NEWER), "told"),
    "contexts with a newer key": (written(CONTEXTS, NEWER_OUTSIDE), "told"),
    "contexts that use a list": (written(CONTEXTS, b"use: [1]\ncontexts: {}\n"), "told"),
    "contexts that use a map": (written(CONTEXTS, b"use: {a: b}\ncontexts: {}\n"), "told"),
    "a context with a NUL in a path": (
        written(CONTEXTS, b'use: lab\ncontexts: {lab: {swarm: meadow, config: "/a\\0b"}}\n'),
        "told",
    ),
    "contexts a folder": (a_folder(CONTEXTS), "told"),
    "contexts a link": (leading_nowhere(CONTEXTS), "told"),
    "settings a link": (moved_away(CONFIG), "told"),
    "contexts of another user": (unreadable(CONTEXTS), "told"),
    "settings of another user": (unreadable(CONFIG), "told"),
    "identities of another user": (unreadable(CONFIG / "identities"), "told"),
    "a context that is not there": (with_variable("SWARM_CONTEXT", "labb"), "told"),
    "$SWARM_CONFIG missing": (with_variable("SWARM_CONFIG", "/nonexistent/swarm.yaml"), "told"),
    "$SWARM_CONFIG broken": (
        with_variable("SWARM_CONFIG", "{home}/swarm.yaml", written(SWARM_YAML, BAD_YAML)),
        "told",
    ),
    "$SWARM_CONFIG newer": (
        with_variable("SWARM_CONFIG", "{home}/swarm.yaml", written(SWARM_YAML, b"wings: 2\n")),
        "told",
    ),
    "cache a file": (written(Path(".cache"), b"x"), "applied"),
    "cache of another user": (unreadable(Path(".cache")), "applied"),
    "known robots": (written(Path(".cache/swarmd/members-dev-meadow.json"), b"\0"), "applied"),
    "$XDG_CACHE_HOME missing": (with_variable("XDG_CACHE_HOME", "/nonexistent"), "applied"),
    "state a file": (written(Path(".local/state"), b"x"), "applied"),
    "$XDG_STATE_HOME missing": (with_variable("XDG_STATE_HOME", "/nonexistent"), "applied"),
    "no HOME": (with_variable("HOME", None), "applied"),
    "HOME missing": (with_variable("HOME", "/nonexistent/anna"), "applied"),
    "HOME no folder": (with_variable("HOME", "/dev/null"), "applied"),
    "$TMPDIR missing": (with_variable("TMPDIR", "/nonexistent"), "applied"),
}


def result_of(words: tuple[str, ...]) -> tuple[Result, str]:
    """What `swarmctl` did, and what it wrote to stderr."""
    done = swarmctl(*words)
    assert done.code in (0, 2), done
    if done.code == 2:
        assert done.err.count("\n") == 1, done.err
        return "refused", done.err
    return "told" if done.err else "applied", done.err


@pytest.mark.parametrize("case", BROKEN)
def test_a_stop_that_names_its_swarm_needs_no_file(
    case: str, home: Path, sending: type[Sending], monkeypatch: pytest.MonkeyPatch
) -> None:
    break_it, wanted = BROKEN[case]
    break_it(home, monkeypatch)
    assert result_of((*MEADOW, "stop"))[0] == wanted
    ((swarm, _, name),) = sending.sent
    assert (swarm, name) == ("meadow", None)


@pytest.mark.parametrize("case", BROKEN)
def test_a_swarm_of_the_environment_does_as_well_or_the_line_says_what_does(
    case: str, home: Path, sending: type[Sending], monkeypatch: pytest.MonkeyPatch
) -> None:
    """A swarm file counts more than $SWARM, so a broken one may name another swarm."""
    break_it, wanted = BROKEN[case]
    break_it(home, monkeypatch)
    monkeypatch.setenv("SWARM", "meadow")
    result, text = result_of(("estop",))
    if case.startswith("$SWARM_CONFIG"):
        assert (result, sending.sent) == ("refused", [])
        assert "swarmctl --swarm NAME estop" in text
    else:
        assert result == wanted
        assert [one[0] for one in sending.sent] == ["meadow"]


@pytest.mark.parametrize("case", [case for case, (_, result) in BROKEN.items() if result == "told"])
def test_no_swarm_is_guessed_from_a_broken_file(
    case: str, home: Path, sending: type[Sending], monkeypatch: pytest.MonkeyPatch
) -> None:
    BROKEN[case][0](home, monkeypatch)
    result, text = result_of(("estop",))
    if case == "identities of another user":  # the context names the swarm
        assert (result, sending.sent) == ("told", [("meadow", "dev", None)])
    else:
        assert (result, sending.sent) == ("refused", [])
        assert "swarmctl --swarm NAME estop" in text


@pytest.mark.parametrize("case", BROKEN)
def test_insecure_needs_no_look_at_keys(
    case: str, home: Path, sending: type[Sending], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(Sending, "has_keys", True)
    BROKEN[case][0](home, monkeypatch)
    result_of((*MEADOW, "--insecure", "stop"))
    assert [(swarm, name) for swarm, _, name in sending.sent] == [("meadow", None)]


HIDES_KEYS = ["settings a link", "settings of another user", "identities of another user"]
HIDES_PATH = [case for case in BROKEN if case.startswith("contexts ") and "newer" not in case]


@pytest.mark.parametrize("case", HIDES_KEYS + HIDES_PATH)
def test_without_a_robot_without_keys_nothing_is_sent_unsigned(
    case: str, home: Path, sending: type[Sending], monkeypatch: pytest.MonkeyPatch
) -> None:
    """The broken file may have named, or may contain, the keys of the swarm."""
    monkeypatch.setattr(Sending, "has_keys", True)
    BROKEN[case][0](home, monkeypatch)
    result, text = result_of((*MEADOW, "estop"))
    assert (result, sending.sent) == ("refused", [])
    assert all(word in text for word in ("--swarm meadow", "--identity", "--insecure"))


@pytest.mark.parametrize("case", [case for case in BROKEN if case not in HIDES_KEYS])
def test_installed_keys_sign_the_stop(
    case: str,
    home: Path,
    keys: SwarmKeys,
    sending: type[Sending],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(Sending, "has_keys", True)
    keys.authority.issue("alice").write(home / KEYS)
    break_it, wanted = BROKEN[case]
    break_it(home, monkeypatch)
    if case.startswith(("no HOME", "HOME")):  # the keys are not there either
        assert result_of((*MEADOW, "--identity", str(home / KEYS), "estop"))[0] == "applied"
    else:
        assert result_of((*MEADOW, "estop"))[0] == wanted
    assert [(swarm, name) for swarm, _, name in sending.sent] == [("meadow", "alice")]


def without(name: str) -> Break:
    return lambda home, monkeypatch: (home / KEYS / name).unlink()


@pytest.mark.parametrize(
    "break_it",
    [
        *(without(name) for name in (INFO, KEY, ROSTER)),
        *(written(KEYS / name, b"") for name in (INFO, ROSTER)),
        *(written(KEYS / name, bytes(64)) for name in (INFO, ROSTER)),
        unreadable(KEYS),
        unreadable(KEYS / INFO),
        unreadable(KEYS / KEY),
        lambda home, monkeypatch: (home / KEYS / KEY).chmod(0o644),
    ],
)
def test_keys_that_cannot_be_used_are_never_replaced_by_none(
    break_it: Break,
    home: Path,
    keys: SwarmKeys,
    sending: type[Sending],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    keys.authority.issue("alice").write(home / KEYS)
    break_it(home, monkeypatch)
    result, text = result_of((*MEADOW, "estop"))
    assert (result, sending.sent) == ("refused", [])
    assert all(word in text for word in (str(KEYS), "--swarm meadow", "--identity", "--insecure"))


@pytest.mark.parametrize("path", [KEYS, CONFIG / "identities"])
def test_keys_on_a_drive_that_is_not_there_are_never_replaced_by_none(
    path: Path, home: Path, sending: type[Sending], monkeypatch: pytest.MonkeyPatch
) -> None:
    leading_nowhere(path)(home, monkeypatch)
    monkeypatch.setattr(Sending, "has_keys", True)
    result, text = result_of((*MEADOW, "estop"))
    assert (result, sending.sent) == ("refused", [])
    assert "--identity" in text


def test_a_swarm_file_of_the_line_is_not_needed_for_a_stop_alone(
    home: Path, sending: type[Sending]
) -> None:
    (home / "swarm.yaml").write_bytes(BAD_YAML)
    line = (*MEADOW, "--config", str(home / "swarm.yaml"))
    assert result_of((*line, "stop"))[0] == "told"
    assert [one[0] for one in sending.sent] == ["meadow"]
    assert result_of((*line, "run", "attraction", "--all"))[0] == "refused"


def test_the_options_of_the_context_of_the_swarm_count_as_far_as_they_are_known(
    home: Path, sending: type[Sending]
) -> None:
    (home / CONTEXTS).write_bytes(NEWER)
    assert result_of((*MEADOW, "estop"))[0] == "told"
    assert sending.sent == [("meadow", "field", None)]


@pytest.mark.parametrize(
    "options",
    [
        b"profile: field, interface: gone9",
        b'profile: field, interface: "a\\0b"',
        b"seeds: [tcp/host:7440]",
    ],
)
def test_a_network_of_the_context_that_this_machine_lacks_is_named_with_another_line(
    options: bytes, home: Path, sending: type[Sending]
) -> None:
    """An interface that was unplugged; seeds in the profile of this machine alone."""
    text = b"use: lab\ncontexts:\n  lab: {swarm: meadow, " + options + b"}\n"
    (home / CONTEXTS).write_bytes(text)
    done = swarmctl(*MEADOW, "estop")
    assert done.code in (2, 6)
    assert done.err.count("\n") == 1
    assert "context" in done.err
    assert "swarmctl --swarm NAME --profile PROFILE --interface INTERFACE estop" in done.err
    assert sending.sent == []
    done = swarmctl(*MEADOW, "--profile", "field", "--interface", "lo", "estop")
    assert done.code == 0, done
    assert sending.sent == [("meadow", "field", None)]


@pytest.mark.parametrize(
    ("options", "subject"),
    [
        (b"swarm: other, profile: field, interface: lo, relay: 3", "dev"),
        (b"profile: field, interface: lo, relay: 3", "dev"),
        (b"swarm: meadow, profile: mesh", "dev"),
    ],
)
def test_a_broken_context_of_another_swarm_is_not_used(
    options: bytes, subject: str, home: Path, sending: type[Sending]
) -> None:
    (home / CONTEXTS).write_bytes(b"use: lab\ncontexts:\n  lab: {" + options + b"}\n")
    assert result_of((*MEADOW, "estop"))[0] == "told"
    assert sending.sent == [("meadow", subject, None)]


@pytest.mark.parametrize("value", ["[own]", "keys"])
def test_wrong_keys_of_a_context_are_never_replaced_by_none(
    value: str, home: Path, sending: type[Sending], monkeypatch: pytest.MonkeyPatch
) -> None:
    (home / CONTEXTS).write_text(
        f"use: lab\ncontexts:\n  lab: {{swarm: meadow, relay: 3, identity: {value}}}\n"
    )
    monkeypatch.setattr(Sending, "has_keys", True)
    result, _ = result_of((*MEADOW, "estop"))
    assert (result, sending.sent) == ("refused", [])


def test_the_line_decides_about_keys_more_than_the_context(
    home: Path, keys: SwarmKeys, sending: type[Sending]
) -> None:
    add_context("lab", Context(swarm="meadow", identity="/nonexistent/alice"), use=True)
    assert result_of((*MEADOW, "estop"))[0] == "refused"
    assert result_of((*MEADOW, "--insecure", "estop"))[0] == "applied"
    add_context("lab", Context(swarm="meadow", insecure=True), use=True)
    own = str(keys.folder_of("alice"))
    assert result_of((*MEADOW, "--identity", own, "estop"))[0] == "applied"
    assert [name for _, _, name in sending.sent] == [None, "alice"]


@pytest.mark.parametrize("case", BROKEN)
def test_an_estop_of_python_needs_no_file(
    case: str, home: Path, sending: type[Sending], monkeypatch: pytest.MonkeyPatch
) -> None:
    break_it, wanted = BROKEN[case]
    break_it(home, monkeypatch)
    told = list[str]()
    with swarmd.connect("meadow", tell=told.append) as swarm:
        assert swarm.estop().applied == ("r1",)
    assert [one[0] for one in sending.sent] == ["meadow"]
    assert bool(told) == (wanted == "told")


def test_a_context_that_a_program_names_is_needed(home: Path, sending: type[Sending]) -> None:
    (home / CONTEXTS).write_bytes(CUT)
    with pytest.raises(ConfigError, match=r"swarmctl --swarm NAME estop"):
        swarmd.connect("meadow", context="lab").open()


# The file of contexts


@pytest.mark.parametrize("verb", [("list",), ("add", "new", "--swarm", "new"), ("use", "lab")])
@pytest.mark.parametrize("content", [CUT, b"", bytes(64), NEWER, NEWER_OUTSIDE])
def test_a_broken_file_of_contexts_is_one_line_and_stays_as_it_is(
    verb: tuple[str, ...], content: bytes, home: Path
) -> None:
    (home / CONTEXTS).write_bytes(content)
    done = swarmctl("context", *verb)
    assert done.code == 2
    assert done.err.count("\n") == 1
    assert "contexts.yaml" in done.err
    assert "move it away" in done.err
    assert (home / CONTEXTS).read_bytes() == content


def test_the_contexts_that_can_be_read_are_listed(home: Path) -> None:
    add_context("class", Context(swarm="class"))
    text = (home / CONTEXTS).read_text().replace("swarm: meadow", "swarm: meadow\n    relay: 3")
    (home / CONTEXTS).write_text(text)
    done = swarmctl("context", "list", "-o", "json")
    assert done.code == 2
    assert done.json["contexts"] == {"class": {"swarm": "class"}}
    assert len(done.json["faults"]) == 1
    assert "class" in swarmctl("context", "list").out


def test_contexts_of_another_user_are_not_taken_for_none(
    home: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    deny(home / CONFIG, monkeypatch)
    done = swarmctl("context", "list")
    assert done.code == 2
    assert "chown" in done.err
    assert done.err.count("\n") == 1


def test_contexts_reach_the_disk_before_they_get_their_name(
    home: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A power cut leaves the old file or the new one, never an empty one."""
    path, done = contexts_path(), list[str]()
    assert path is not None
    real_sync, real_replace = os.fsync, os.replace

    def fsync(handle: int) -> None:
        done.append("sync")
        real_sync(handle)

    def replace(old: str, new: str) -> None:
        done.append("replace")
        real_replace(old, new)

    monkeypatch.setattr(os, "fsync", fsync)
    monkeypatch.setattr(os, "replace", replace)
    save_contexts(path, Contexts())
    assert done == ["sync", "replace", "sync"]
