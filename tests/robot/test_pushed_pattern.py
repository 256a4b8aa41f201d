"""The versions of a pushed pattern: provisional, held, returned."""

from __future__ import annotations

import hashlib

from swarmd.core.pattern_manifest import Entry, PatternManifest, Signed, encode_manifest, read_entry
from swarmd.robot.pushed_pattern import HOLD_TIME, MAX_ENDS, PushedPattern, Standing, Version


def entry(version: str, code: str = "", generation: int = 1) -> Entry:
    digest = hashlib.sha256((code or version).encode()).digest()
    manifest = PatternManifest(
        swarm="lab",
        name="flock",
        generation=generation,
        issuer="alice",
        kind="file",
        version=version,
        digest=digest,
    )
    return read_entry(Signed(encode_manifest(manifest)))


def version(name: str, code: str = "", generation: int = 1) -> Version:
    return Version.of(entry(name, code, generation), "alice")


def held(name: str) -> PushedPattern:
    return PushedPattern().accept(version(name)).ran(HOLD_TIME)


def test_a_version_is_provisional_until_it_has_run_long_enough() -> None:
    code = PushedPattern().accept(version("1"))
    assert code.standing is Standing.PROVISIONAL
    code = code.ran(HOLD_TIME - 1.0)
    assert code.standing is Standing.PROVISIONAL
    code = code.ran(1.0)
    assert code.standing is Standing.HELD
    assert code.failed_with("raised") == code  # as any other pattern from now on


def test_a_fault_while_provisional_returns_to_the_version_before() -> None:
    code = held("1").accept(version("2")).failed_with("ZeroDivisionError")
    assert code.current == held("1").current
    assert code.failed == version("2")
    assert (code.standing, code.fault) == (Standing.RETURNED, "ZeroDivisionError")
    assert not code.lacks(entry("2"))  # the same push is not tried again


def test_the_first_version_gives_way_to_nothing() -> None:
    code = PushedPattern().accept(version("1")).failed_with("raised")
    assert code.current is None
    assert code.standing is Standing.RETURNED


def test_known_code_is_kept_over_several_provisional_versions() -> None:
    code = held("1").accept(version("2")).accept(version("3"))
    assert code.failed_with("raised").current == held("1").current
    code = PushedPattern().accept(version("1")).accept(version("2"))
    assert code.failed_with("raised").current == version("1")


def test_a_newer_push_of_the_same_code_keeps_its_standing() -> None:
    first, again = version("1", code="a"), version("1", code="a", generation=7)
    code = PushedPattern().accept(first).ran(20.0)
    assert code.lacks(entry("1", "a", 7))
    code = code.accept(again)
    assert not code.lacks(entry("1", "a", 7))
    assert code.current is not None
    assert (code.current.ran, code.current.signed) == (20.0, again.signed)
    assert code.before is None


def test_a_version_that_fails_its_trial_changes_nothing_but_what_failed() -> None:
    code = held("1").refuse(version("2"), "SyntaxError")
    assert code.current == held("1").current
    assert (code.standing, code.fault) == (Standing.RETURNED, "SyntaxError")
    assert code.accept(version("3")).standing is Standing.PROVISIONAL


def test_ends_of_the_daemon_in_its_runs_return_from_a_version() -> None:
    code = held("1").accept(version("2"))
    for number in range(MAX_ENDS):
        assert code.standing is Standing.PROVISIONAL, number
        code = code.begin().restarted()
    assert code.current == held("1").current
    assert code.standing is Standing.RETURNED
    assert str(MAX_ENDS) in code.fault


def test_an_end_of_the_daemon_between_runs_counts_nothing() -> None:
    code = held("1").accept(version("2")).begin().end()
    assert code.restarted() == code
    assert held("1").begin().restarted().standing is Standing.HELD
