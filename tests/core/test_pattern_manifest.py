"""Manifests of pushed patterns, their order, and the table that robots merge."""

from __future__ import annotations

import random
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from swarmd.core import pattern_manifest
from swarmd.core.errors import CodecError
from swarmd.core.pattern_manifest import (
    Entry,
    PatternManifest,
    Signed,
    decode_table,
    digest_of,
    encode_manifest,
    encode_table,
    merged,
    read_entry,
    wanted_by,
)


def entry(name: str = "flock", generation: int = 1, **fields: Any) -> Entry:
    wanted = {"swarm": "lab", "issuer": "alice", "kind": "file", "digest": bytes(32), **fields}
    manifest = PatternManifest(name=name, generation=generation, **wanted)
    return read_entry(Signed(encode_manifest(manifest)))


entries = st.builds(
    entry,
    st.sampled_from(["flock", "hunt"]),
    st.integers(1, 6),
    issuer=st.sampled_from(["alice", "bob"]),
    targets=st.sampled_from([(), ("r1",), ("r2",), ("r*",)]),
    kind=st.sampled_from(["file", "removed"]),
)


@given(st.lists(entries, max_size=12), st.randoms())
def test_tables_that_know_the_same_are_equal_whichever_way_it_came(
    found: list[Entry], chance: random.Random
) -> None:
    at_once = merged((), found)
    chance.shuffle(found)
    table: tuple[Entry, ...] = ()
    for one in found:
        table = merged(table, [one])
    assert table == at_once
    assert merged(at_once, at_once) == at_once
    assert decode_table(encode_table(table)) == table
    assert digest_of(table) == digest_of(at_once)


@given(st.lists(entries, max_size=12))
def test_a_robot_wants_the_greatest_that_targets_it(found: list[Entry]) -> None:
    wanted = wanted_by("r1", (), merged((), found))
    for name in ("flock", "hunt"):
        own = [one for one in found if one.manifest.name == name and one.manifest.is_for("r1", ())]
        assert wanted.get(name) == max(own, key=lambda one: one.order, default=None)


def test_the_greater_generation_holds_then_the_greater_issuer() -> None:
    old, new = entry(generation=3, issuer="bob"), entry(generation=4)
    other = entry(generation=4, issuer="bob")
    assert merged([new], [old]) == (new,)
    assert merged([new], [other]) == (other,)


def test_a_push_to_some_leaves_that_of_the_others() -> None:
    everywhere, canary = entry(generation=1), entry(generation=2, targets=("r1",))
    table = merged([everywhere], [canary])
    assert wanted_by("r1", (), table)["flock"] == canary
    assert wanted_by("r2", (), table)["flock"] == everywhere
    assert merged(table, [entry(generation=3)]) == (entry(generation=3),)


def test_targets_are_names_globs_and_labels() -> None:
    manifest = entry(targets=("r1", "tb3-*", "label:red")).manifest
    assert manifest.is_for("r1", ())
    assert manifest.is_for("tb3-07", ())
    assert manifest.is_for("r9", ("red",))
    assert not manifest.is_for("r9", ("blue",))


def test_a_full_table_forgets_old_removals_first(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(pattern_manifest, "MAX_TABLE", 2)
    kept, removal = entry("a", 1), entry("b", 2, kind="removed")
    assert merged([kept, removal], [entry("c", 3)]) == (entry("c", 3), kept)
    assert merged([entry("a", 1), entry("b", 2)], [entry("c", 3)]) == (entry("c", 3), entry("b", 2))


def test_a_manifest_with_another_signature_is_the_same_entry() -> None:
    one = entry()
    other = read_entry(Signed(one.signed.content, b"\xff" * 64))
    assert other == one
    assert other.order == one.order
    assert digest_of((other,)) == digest_of((one,))
    assert merged([one], [other])[0].signed == one.signed


def test_another_encoding_of_a_manifest_is_refused() -> None:
    content = encode_manifest(entry().manifest)
    longer = b"\xde\x00" + bytes([content[0] & 0x0F]) + content[1:]
    more = bytes([content[0] + 1]) + content[1:] + b"\xa4more\x01"
    for other in (longer, more):
        with pytest.raises(CodecError):
            read_entry(Signed(other))


def test_manifests_out_of_bounds_are_refused() -> None:
    with pytest.raises(CodecError, match="SHA-256"):
        entry(digest=b"short")
    for content in (b"", b"\xc1", encode_manifest(entry().manifest)[:-3]):
        with pytest.raises(CodecError):
            read_entry(Signed(content))
    with pytest.raises(CodecError):
        read_entry(Signed(encode_manifest(entry().manifest).replace(b"flock", b"../up")))
    with pytest.raises(CodecError):
        decode_table(b"\xc1")
