"""Which robots are mute or deaf, as peers tell one another: by hand, without a network."""

from __future__ import annotations

import random
from collections.abc import Callable

from swarmd.link.members.hearing import Hearing, Report
from tests.link.virtual_network import VirtualNetwork

Arrives = Callable[[str, str], bool]
Faults = set[tuple[str, str]]


class Swarm:
    """Robots that beacon once a second; `arrives(sender, receiver)` of messages."""

    def __init__(self, names: str, arrives: Arrives, rate: float = 10.0) -> None:
        self.now = 50.0
        self.arrives = arrives
        self.beacon_arrives: Arrives = lambda sender, receiver: True
        self.rates = dict.fromkeys(names, rate)
        self.sent = dict.fromkeys(names, 0.0)
        self.number = 0
        self.robots = {name: Hearing(name) for name in names}

    def run(self, seconds: int) -> Swarm:
        """Let each robot send its messages and a beacon, once a second."""
        for _ in range(seconds):
            self.now += 1.0
            self.number += 1
            for sender, rate in self.rates.items():
                before = int(self.sent[sender])
                self.sent[sender] += rate
                for _ in range(int(self.sent[sender]) - before):
                    for name, hearing in self.robots.items():
                        if name != sender and self.arrives(sender, name):
                            hearing.on_message(sender, sender.encode(), self.now)
            for sender, sent in self.sent.items():
                report = self.robots[sender].report
                for name, hearing in self.robots.items():
                    if name != sender and self.beacon_arrives(sender, name):
                        hearing.on_beacon(
                            *(sender, sender.encode(), self.number, int(sent), report, self.now)
                        )
            for hearing in self.robots.values():
                hearing.advance(self.now)
        return self

    def told(self, by: str) -> Faults:
        return {(fault.robot, fault.kind) for fault in self.robots[by].faults}


def mute(*names: str) -> Arrives:
    return lambda sender, receiver: sender not in names


def deaf(*names: str) -> Arrives:
    return lambda sender, receiver: receiver not in names


def test_all_robots_name_a_mute_robot_itself_included() -> None:
    swarm = Swarm("abcde", mute("c")).run(9)
    assert [swarm.told(name) for name in "abcde"] == [{("c", "mute")}] * 5
    (fault,) = swarm.robots["c"].faults
    assert (fault.by, fault.of) == (4, 4)


def test_all_robots_name_a_deaf_robot_and_accuse_none_of_whom_it_misses() -> None:
    swarm = Swarm("abcde", deaf("c")).run(9)
    assert [swarm.told(name) for name in "abcde"] == [{("c", "deaf")}] * 5


def test_in_a_sound_swarm_and_in_a_silent_one_nothing_is_told() -> None:
    sound = Swarm("abcde", mute()).run(30)
    silent = Swarm("abcde", mute(*"abcde"), rate=0.0).run(30)
    assert all(one.told(name) == set() for one in (sound, silent) for name in "abcde")


def test_of_a_robot_that_sends_nothing_nothing_is_told() -> None:
    swarm = Swarm("abcde", mute("c"))
    swarm.rates["c"] = 0.0
    assert swarm.run(30).told("a") == set()


def test_one_robot_alone_suspects_and_the_others_say_nothing() -> None:
    swarm = Swarm("abcde", lambda sender, receiver: (sender, receiver) != ("c", "a")).run(9)
    assert swarm.told("a") == {("c", "unheard")}
    (fault,) = swarm.robots["a"].faults
    assert (fault.by, fault.of) == (0, 3)
    assert [swarm.told(name) for name in "bcde"] == [set()] * 4


def test_of_two_robots_neither_is_named() -> None:
    assert Swarm("ab", mute("b")).run(30).told("a") == {("b", "unheard")}


def test_a_minority_names_nobody() -> None:
    swarm = Swarm("abcdefg", lambda sender, receiver: sender != "c" or receiver in "defg").run(9)
    assert [swarm.told(name) for name in "ad"] == [{("c", "unheard")}, set()]


def test_a_deaf_and_a_mute_robot_are_both_named() -> None:
    swarm = Swarm("abcdefg", lambda sender, receiver: sender != "b" and receiver != "c").run(9)
    assert swarm.told("a") == {("b", "mute"), ("c", "deaf")}


def test_of_three_mute_robots_of_five_none_makes_another_deaf() -> None:
    swarm = Swarm("abcde", mute("b", "c", "d")).run(9)
    assert swarm.told("a") == swarm.told("e") == {(name, "mute") for name in "bcd"}


def test_a_robot_that_misses_two_and_hears_three_is_not_deaf() -> None:
    swarm = Swarm("abcdef", lambda sender, receiver: receiver != "a" or sender in "def").run(9)
    assert swarm.told("a") == {("b", "unheard"), ("c", "unheard")}
    assert swarm.told("d") == set()


def test_a_robot_is_not_deaf_by_the_word_of_one_other() -> None:
    hearing = Hearing("a")
    for number in (1, 2):
        hearing.on_message("b", b"b", 9.0 + number)  # b itself tells nothing
        hearing.on_beacon("b", b"b", number, 10 * number, Report(), 9.0 + number)
        deaf_report = Report(frozenset("ab"), 0)
        hearing.on_beacon("c", b"c", number, 0, deaf_report, 9.0 + number)
    hearing.on_message("b", b"b", 11.0)
    hearing.advance(11.0)
    assert hearing.report == Report(frozenset(), 1)
    assert hearing.faults == ()


def test_many_beacons_and_messages_of_one_second_are_no_evidence() -> None:
    hearing = Hearing("a")
    for number in range(20):
        now = 10.0 + 0.05 * number
        hearing.on_beacon("b", b"b", number, 10 * number, Report(), now)
    hearing.advance(11.0)
    assert hearing.report == Report()


def test_five_seconds_of_silence_and_ten_messages_name_and_one_message_clears() -> None:
    swarm = Swarm("abcd", mute("b")).run(5)
    assert swarm.told("a") == set()
    assert swarm.run(3).told("a") == {("b", "mute")}
    swarm.arrives = mute()
    assert swarm.run(2).told("a") == set()


def test_one_lost_burst_of_messages_names_nobody() -> None:
    swarm = Swarm("abcd", lambda sender, receiver: True).run(20)
    swarm.arrives = mute("a")
    swarm.run(1).rates["a"] = 0.0  # its run ends as its last second of messages is lost
    assert {one for _ in range(20) for name in "abcd" for one in swarm.run(1).told(name)} == set()


def test_a_slow_sender_needs_ten_messages() -> None:
    swarm = Swarm("abcd", mute("b"), rate=0.5).run(18)
    assert swarm.told("a") == set()
    assert swarm.run(6).told("a") == {("b", "mute")}


def test_a_fault_ends_ten_seconds_after_the_last_message_of_its_robot() -> None:
    swarm = Swarm("abcd", mute("b")).run(10)
    swarm.rates["b"] = 0.0
    assert swarm.run(9).told("a") == {("b", "mute")}
    assert swarm.run(3).told("a") == set()


def test_messages_of_a_time_without_beacons_are_no_evidence() -> None:
    swarm = Swarm("abcd", mute()).run(3)
    swarm.arrives = swarm.beacon_arrives = lambda sender, receiver: False
    swarm.run(20)
    swarm.arrives = swarm.beacon_arrives = lambda sender, receiver: True
    swarm.rates = dict.fromkeys("abcd", 0.0)
    assert swarm.run(9).told("a") == set()


def test_a_restarted_robot_and_one_of_an_older_version_are_not_accused() -> None:
    hearing = Hearing("a")
    for number in range(1, 30):
        now = 10.0 + number
        hearing.on_beacon("old", b"1", number, 0, hearing.report, now)
        hearing.on_beacon("new", b"%d" % (number // 4), number, 100 * number, hearing.report, now)
        hearing.advance(now)
    assert hearing.faults == ()


def test_with_half_of_all_datagrams_lost_nobody_is_named() -> None:
    draw = random.Random(4)
    lost: Arrives = lambda sender, receiver: draw.random() < 0.5  # noqa: E731
    swarm = Swarm("abc", lost, rate=4.0)
    swarm.beacon_arrives = lost
    assert {one for _ in range(100) for name in "abc" for one in swarm.run(1).told(name)} == set()


def test_beacons_carry_what_is_missed_to_all() -> None:
    network = VirtualNetwork(4)

    all_of = network.robots.values()

    def say(name: str, is_mute: bool) -> None:
        robot = network.robots[name]
        message = robot.peer.message("p/x", b"\xc0")
        for other, peer in network.robots.items():
            if other != name and not is_mute:
                peer.peer.on_datagram(message, robot.address, network.now, peer.summary)

    for _ in range(90):
        for name in network.robots:
            say(name, is_mute=name == "r3")
        network.run(0.1)
    told = [{(one.robot, one.kind) for one in robot.peer_faults if one.by > 1} for robot in all_of]
    assert told == [{("r3", "mute")}] * 4
