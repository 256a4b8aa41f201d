"""The stops that a robot knows, by the clocks of the machines that issued them."""

from __future__ import annotations

from swarmd.robot.issue_time import MAX_CLOCKS, MAX_WAY, IssueTime, KnownStops


def test_stops_of_more_clocks_than_are_kept_count_by_the_own_clock() -> None:
    """64 clocks are kept (docs/security.md); what forges more of them must not fill the memory."""
    known = KnownStops()
    for n in range(MAX_CLOCKS):
        known.note(IssueTime(1.0, f"clock{n}", 100.0), "anna")
    assert known.later_than(IssueTime(0.9, "other", 50.0)) == "anna"
    assert known.later_than(IssueTime(1.1, "other", 50.0)) == ""
    for n in range(1000):
        known.note(IssueTime(5.0 + 0.001 * n, f"forged{n}", 100.0), "eve")
    assert len(known._newest) <= MAX_CLOCKS + 1
    assert known.later_than(IssueTime(5.998, "other", 50.0)) == "eve"
    assert known.later_than(IssueTime(6.0, "other", 50.0)) == ""


def test_the_issuer_of_the_newest_stop_is_named_whatever_came_last() -> None:
    known = KnownStops()
    known.note(IssueTime(5.0, "a", 100.0), "bob")
    known.note(IssueTime(4.0, "a", 99.0), "anna")  # on its way for longer
    assert known.later_than(IssueTime(4.5, "a", 99.5)) == "bob"
    assert known.later_than(IssueTime(5.5, "a", 100.5)) == ""


def test_two_machines_with_one_clock_id_are_both_known() -> None:
    """The differences of both clocks differ by more than MAX_WAY: the earlier counts by ours."""
    known = KnownStops()
    known.note(IssueTime(5.0, "a", 100.0), "bob")
    known.note(IssueTime(4.0, "a", 99.0 + MAX_WAY + 0.1), "anna")  # a clone, heard late
    assert known.later_than(IssueTime(4.9, "a", 99.9)) == "bob"
    # Of the machine of the later stop: its clock shows that it came before, on a longer way.
    assert known.later_than(IssueTime(5.3, "a", 99.9)) == "bob"
    assert known.later_than(IssueTime(5.1, "a", 100.1)) == ""


def test_of_two_machines_with_one_clock_id_the_last_that_was_heard_at_an_instant_keeps_it() -> None:
    """Its user is the one who orders next; the other stop counts by the own clock alone."""
    known = KnownStops()
    known.note(IssueTime(5.0, "a", 100.0), "bob")
    known.note(IssueTime(5.0, "a", 100.0 + MAX_WAY + 1.0), "anna")
    assert known.later_than(IssueTime(5.1, "a", 102.9)) == "anna"  # 0.1 s before hers, by her clock
    assert known.later_than(IssueTime(5.1, "a", 103.1)) == ""


# The docstring of issue_time.py has these rules and bounds: 64 clocks, 2 s of ways, 60 s frozen.


def test_sixty_four_clocks_are_kept() -> None:
    assert MAX_CLOCKS == 64
    assert IssueTime(1.0) == (1.0, "", 0.0)


def test_equal_times_start_a_run_and_end_one() -> None:
    for clock in ("", "a"):
        order = IssueTime(1.0, clock, 5.0)
        assert not order.is_before(order)
        assert not order.is_surely_before(order)


def test_the_clock_of_the_machine_counts_while_ways_differ_by_two_seconds() -> None:
    start = IssueTime(3.0, "a", 10.0)
    assert not start.is_before(IssueTime(5.0, "a", 10.0))  # 2 s more on its way: not later
    assert start.is_before(IssueTime(5.5, "a", 10.0))  # by the own clock alone
    assert start.is_before(IssueTime(2.5, "a", 10.1))


def test_a_stop_hidden_for_a_minute_ends_a_run_that_its_machine_asked_for_before() -> None:
    stop = IssueTime(1.0, "a", 10.0)
    assert not stop.is_surely_before(IssueTime(61.0, "a", 10.0))  # its clock shows no later start
    assert stop.is_surely_before(IssueTime(61.0, "a", 10.5))
    assert stop.is_surely_before(IssueTime(61.5, "a", 10.0))  # no freeze takes as long
    assert stop.is_surely_before(IssueTime(1.5, "b", 9.0))
    assert not stop.is_surely_before(IssueTime(0.5, "b", 11.0))


def test_a_known_stop_counts_by_the_clock_of_its_machine_alone() -> None:
    """A start that was issued after it, and had the shorter way, seems to be earlier here."""
    known = KnownStops()
    known.note(IssueTime(5.0, "a", 100.0), "bob")
    assert known.later_than(IssueTime(4.5, "a", 100.5)) == ""
    assert known.later_than(IssueTime(4.5, "b", 100.5)) == "bob"
