"""Keys of Zenoh: what is built is parsed, and nothing else."""

from __future__ import annotations

import pytest

from swarmd.core.keys import ANY, Key, build, named_by, parse, token


@pytest.mark.parametrize(
    "key",
    [
        Key("lab", "r1", "state", "status"),
        Key("lab", "r1", "multicast", "all"),
        Key("lab", "r1", "control", "run", "alice"),
        Key("lab", "r1", "shared", "roster", "r2"),
        Key("lab", "teacher", "message", "voter_model", "opinion"),
    ],
)
def test_a_key_is_parsed_as_it_was_built(key: Key) -> None:
    assert parse(build(*key)) == key


@pytest.mark.parametrize(("plane", "asker"), [("control", ""), ("state", "alice")])
def test_only_questions_have_an_asker(plane: str, asker: str) -> None:
    with pytest.raises(ValueError, match=plane):
        build("lab", "r1", plane, "run", asker)


@pytest.mark.parametrize(
    "text",
    [
        "swarm/lab/r1/control/run",
        "swarm/lab/r1/control/run/*",
        "swarm/lab/r1/control/*/alice",
        "swarm/lab/r1/state/status/alice",
        "swarm/lab/*/state/status/alice",
        "swarm/*/r1/control/run/alice",
        "swarm/lab/r1/other/run",
        "swarm/lab/r1/msg/voter/opinion",
        "lab/r1/control/run/alice",
        "**",
    ],
)
def test_a_wild_or_foreign_key_is_none(text: str) -> None:
    assert parse(text) is None
    assert parse(text, is_query=True) is None


def test_the_robot_of_a_query_may_be_any() -> None:
    text = build("lab", ANY, "control", "run", "alice")
    assert parse(text) is None
    assert parse(text, is_query=True) == ("lab", ANY, "control", "run", "alice")


def test_a_token_names_a_robot_or_program() -> None:
    assert named_by(token("lab", "r1")) == "r1"


@pytest.mark.parametrize(
    "text", ["swarm/lab", "swarm/lab/*", "swarm/lab/R1", "lab/x/r1", "swarm/lab/r1/state", "", "**"]
)
def test_a_foreign_token_names_none(text: str) -> None:
    assert named_by(text) is None
