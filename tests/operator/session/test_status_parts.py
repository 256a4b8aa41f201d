"""Statuses by datagram, in virtual time: the robots' own protocol, and a look of an operator."""

from __future__ import annotations

import pytest
from msgspec.structs import replace

from swarmd.core.codec import encode
from swarmd.core.errors import CodecError
from swarmd.core.messages import Member, PeerView, Presence, Status
from swarmd.link.datagram import (
    MAX_STATUS_PARTS,
    STATUS_PART_BYTES,
    Address,
    Beacon,
    Flag,
    MemberList,
    MemberReport,
    Solicit,
    StatusPart,
    pack,
    status_parts,
    unpack,
)
from swarmd.link.members.answer_budget import ANSWER_RATE_OF_HOST, STATUS_RATE
from swarmd.link.members.membership import MAX_MEMBERS
from swarmd.operator.session.carriers import OperatorDatagrams
from swarmd.operator.session.clocks import SOLICIT_PACE, Arrivals, RepeatTimer, RoundTrips
from swarmd.operator.session.discovery import Discovery
from swarmd.operator.session.member_reports import PARTS_WAIT, StatusParts, decode_status
from swarmd.operator.session.members_view import Contact
from tests.link.keyring import Keyring
from tests.link.virtual_network import TAG, TICK, VirtualNetwork
from tests.support.fake_daemon import light_status

CAP = 20.0  # s of virtual time
LINK_TRIPS = 4.0  # round trips until a robot that is dialled has answered


class TellingNetwork(VirtualNetwork):
    """Robots that tell their status, but for those in `silent`, as of an earlier version.

    Each status fills two parts; of the robots in `long` more than MAX_STATUS_PARTS.
    """

    def __init__(self, telling: int, *, silent: str = "", long: str = "", seed: int = 1) -> None:
        super().__init__(0, joined=False, seed=seed)
        self.statuses: dict[str, Status] = {}
        for number in range(1, telling + 1):
            self._add_telling(f"r{number}", 3 * MAX_STATUS_PARTS if f"r{number}" in long else 2)
        for name in silent.split():
            self.add(name)
        self.run(3.0)

    def _add_telling(self, name: str, texts: int) -> None:
        instance = (self._lives + 1).to_bytes(6, "big").hex()
        findings = tuple(f"{number:0500}" for number in range(texts))
        self.statuses[name] = replace(light_status(name, instance), findings=findings)
        self.add(name, make_status=lambda: encode(self.statuses[name]))


class Look:
    """A look by datagrams in virtual time; `dialled`: when each robot was dialled, in s."""

    def __init__(self, network: TellingNetwork) -> None:
        self.network = network
        network.heard.clear()
        self.found = Discovery(network.now, asks_by_datagram=True)
        self.dialled: dict[str, float] = {}
        self._datagrams = OperatorDatagrams(
            self, TAG, "lo", Arrivals(), lambda body, source, now: True
        )

    def send(self, payload: bytes) -> None:
        """The carrier: to all."""
        self.network.send(self._body(payload))

    def send_to(self, payload: bytes, address: Address) -> None:
        """The carrier: to one robot."""
        names = {robot.address: name for name, robot in self.network.robots.items()}
        self.network.send(self._body(payload), names[address])

    def confirm(self, source: Address) -> None:
        """Every source is answered."""

    def start_thread(self, on_datagram: object) -> None:
        """What arrives is in `network.heard`."""

    def close(self) -> None:
        """Nothing is open."""

    def run(self) -> float:
        """Look until all have answered; the seconds it took."""
        network = self.network
        timer = RepeatTimer(network.now, SOLICIT_PACE)
        while not self.found.is_complete(network.now):
            assert network.now - self.found.started < CAP, "never complete"
            if timer.is_due(network.now):
                self._datagrams.solicit(self.found, network.now)
            for robot, _ in self.found.to_link(network.now):
                self.dialled.setdefault(robot, network.now - self.found.started)
            network.run(TICK)
            self._hear()
            self._answer_on_links()
        return network.now - self.found.started

    def status(self, robot: str) -> Status | None:
        return self.found.result(self.network.now).members[robot].status

    @staticmethod
    def _body(payload: bytes) -> Solicit:
        body = unpack(TAG, payload)
        assert isinstance(body, Solicit)
        return body

    def _hear(self) -> None:
        addresses = {one.peer.robot: one.address for one in self.network.robots.values()}
        for at, body in self.network.heard:
            if isinstance(body, Beacon):
                self.found.on_beacon(body, addresses[body.robot], at)
            elif isinstance(body, MemberList):
                self.found.on_member_list(body, at)
            elif isinstance(body, StatusPart):
                self.found.on_status_part(body, at)
        self.network.heard.clear()

    def _answer_on_links(self) -> None:
        now = self.network.now
        for robot, at in self.dialled.items():
            if now - self.found.started < at + LINK_TRIPS * 2.0 * self.network.delay:
                continue
            instance = next(iter(self.found.holders(robot)))
            status = self.network.statuses.get(robot, light_status(robot, instance))
            self.found.on_view(PeerView(robot=robot, status=status, members=()), now)


def test_a_look_has_every_status_and_dials_nobody() -> None:
    network = TellingNetwork(6)
    look = Look(network)
    assert look.run() <= 4 * TICK
    assert not look.dialled
    assert {name: look.status(name) for name in network.statuses} == network.statuses
    view = look.found.result(network.now)
    assert {member.contact for member in view.members.values()} == {Contact.ANSWERED}
    assert all(member.age <= 4 * TICK for member in view.members.values())


def test_only_a_robot_of_an_earlier_version_is_dialled_and_at_once() -> None:
    network = TellingNetwork(3, silent="old")
    look = Look(network)
    look.run()
    assert list(look.dialled) == ["old"]
    assert look.dialled["old"] < PARTS_WAIT
    assert {name: look.status(name) for name in network.statuses} == network.statuses
    assert look.status("old") is not None


def test_a_status_that_is_too_long_for_datagrams_is_read_on_a_link() -> None:
    network = TellingNetwork(3, long="r2")
    look = Look(network)
    look.run()
    assert list(look.dialled) == ["r2"]
    assert look.status("r2") == network.statuses["r2"]


def test_a_robot_that_the_operator_does_not_reach_is_dialled_once_a_wait_is_over() -> None:
    network = TellingNetwork(3)
    network.reaches = lambda sender, receiver: (sender, receiver) != ("operator", "r2")
    look = Look(network)
    look.run()
    assert list(look.dialled) == ["r2"]
    assert look.dialled["r2"] >= PARTS_WAIT


@pytest.mark.parametrize("seed", range(4))
def test_lost_and_late_datagrams_cost_time_and_no_status(seed: int) -> None:
    network = TellingNetwork(5, silent="old", seed=seed)
    network.loss = 0.2
    network.delay = 0.1
    look = Look(network)
    look.run()
    assert {name: look.status(name) for name in network.statuses} == network.statuses
    assert (
        len(look.dialled) <= 5
    )  # one of an earlier version, and those whose parts or list were lost


def test_a_silent_robot_is_no_answer_by_its_beacon() -> None:
    """It is heard, its beacons have no status, and nothing is claimed of it."""
    network = TellingNetwork(2, silent="old")
    look = Look(network)
    look._datagrams.solicit(look.found, network.now)
    network.run(4 * TICK)
    look._hear()
    assert look.found.answered == {"r1", "r2"}
    assert not look.found.is_complete(network.now)
    member = look.found.result(network.now).members["old"]
    assert (member.contact, member.status) == (Contact.NO_ANSWER, None)


def test_a_secured_swarm_tells_no_status_by_datagram() -> None:
    network = VirtualNetwork(0, joined=False, keyring=Keyring(("r1", "r2"), operators=("anna",)))

    def secret() -> bytes:
        return b"secret"

    for name in ("r1", "r2"):
        network.add(name, make_status=secret)
    network.run(3.0)
    network.is_tapped = True
    network.send(Solicit(echo=5, wants_status=True))
    network.run(1.0)
    assert network.sent_kinds[StatusPart] == 0
    beacons = [body for _, body in network.heard if isinstance(body, Beacon) and body.echo == 5]
    assert {one.robot: one.status_parts for one in beacons} == {"r1": 0, "r2": 0}
    assert not any(b"secret" in raw for _, _, raw, _ in network.tapped)


def test_a_flood_of_questions_gets_a_bounded_number_of_answers() -> None:
    network = TellingNetwork(1)
    network.heard.clear()
    for echo in range(1, 501):
        network.send(Solicit(echo=echo, wants_status=True))
    network.run(0.5)
    kinds = [type(body) for _, body in network.heard]
    assert kinds.count(StatusPart) <= 2 * STATUS_RATE
    assert len(kinds) <= 2 * ANSWER_RATE_OF_HOST


# Parts

CONTENT = encode(light_status("a", "000000000001"))
LIFE = bytes.fromhex("000000000001")


def told(echo: int, content: bytes = CONTENT * 3) -> list[StatusPart]:
    return status_parts("a", LIFE, echo, content)


@pytest.fixture
def parts() -> StatusParts:
    asked = StatusParts()
    for echo in (1, 2):
        asked.on_asked(echo)
    return asked


def test_a_status_is_cut_into_datagrams_of_their_size() -> None:
    content = bytes(MAX_STATUS_PARTS * STATUS_PART_BYTES)
    cut = status_parts("r" * 63, b"abcdef", 2**53, content)
    assert [(one.part, one.parts) for one in cut] == [(n, 8) for n in range(8)]
    assert b"".join(one.content for one in cut) == content
    assert max(len(pack(TAG, one)) for one in cut) <= 1400 - 77  # with the longest signature
    assert status_parts("a", b"abcdef", 1, content + b"x") == []
    assert status_parts("a", b"abcdef", 1, b"") == []


def test_parts_come_in_any_order_and_twice(parts: StatusParts) -> None:
    first, *rest = told(1)
    assert rest
    for one in (*rest, rest[0]):
        assert parts.add(one) is None
    assert parts.add(first) == CONTENT * 3


def test_parts_of_two_answers_make_no_status(parts: StatusParts) -> None:
    old, new = told(1, CONTENT * 3), told(2, bytes(len(CONTENT) * 3))
    assert parts.add(old[0]) is None
    assert [parts.add(one) for one in new[1:]] == [None] * len(new[1:])
    assert parts.add(old[0]) is None
    assert parts.add(new[0]) == bytes(len(CONTENT) * 3)


def test_an_answer_to_another_look_is_dropped(parts: StatusParts) -> None:
    assert [parts.add(one) for one in told(9)] == [None] * len(told(9))


def heard(robot: str, told_parts: int, echo: int = 1) -> Beacon:
    return Beacon(
        robot=robot,
        instance=LIFE,
        echo=echo,
        status_parts=told_parts,
        sequence=1,
        wire=1,
        state=0,
        revision=0,
    )


def test_an_answer_without_parts_is_dialled_and_not_asked_again(parts: StatusParts) -> None:
    one = ("a", LIFE.hex())
    parts.on_beacon(heard("a", 0, echo=0), 0.0)  # a beacon to all announces nothing
    assert not parts.refusing
    parts.on_beacon(heard("a", 0), 0.0)
    assert [*parts.refusing] == [one]
    assert parts.begin_asks([one], 5.0, 0.0, 128) == []


def test_a_robot_is_asked_again_once_a_round_trip_is_over(parts: StatusParts) -> None:
    one = ("a", LIFE.hex())
    assert parts.begin_asks([one], 0.0, 0.2, 128) == [one]
    assert parts.begin_asks([one], 0.29, 0.2, 128) == []
    assert parts.begin_asks([one], 0.31, 0.2, 128) == [one]


def test_each_of_many_robots_is_asked_again_in_its_turn() -> None:
    """At most 128 copies a solicit: of 300 the third solicit asks the last ones."""
    look = Discovery(0.0, asks_by_datagram=True)
    look.on_solicit(1, 0.0, wants_status=True)
    for number in range(300):
        address = (f"10.0.{number // 250}.{1 + number % 250}", 7440)
        look.on_beacon(heard(f"r{number}", 2), address, 0.0)
    turns = [look.to_ask(at) for at in (0.5, 1.0, 1.5)]
    assert [len(turn) for turn in turns] == [128, 128, 128]
    assert len({address for turn in turns for address in turn}) == 300
    assert not {*turns[0]} & {*turns[1]}


def a_list(*members: MemberReport, part: int = 0, parts: int = 1) -> MemberList:
    return MemberList(robot="a", instance=LIFE, members=members, part=part, parts=parts, echo=1)


def told_status(look: Discovery) -> None:
    """The robot `a` is heard, and its whole status has come by datagram."""
    look.on_solicit(1, 0.0, wants_status=True)
    look.on_beacon(heard("a", 1), ("10.0.0.1", 7440), 0.01)
    for one in status_parts("a", LIFE, 1, CONTENT):
        look.on_status_part(one, 0.02)
    assert look.result(0.02).members["a"].status is not None


def test_a_status_by_datagram_is_an_answer_once_the_whole_member_list_has_come() -> None:
    """The list names a robot that only this robot hears."""
    look = Discovery(0.0, asks_by_datagram=True)
    told_status(look)
    assert not look.answered
    assert not look.is_complete(2.0)
    other = MemberReport(
        robot="b", instance=bytes(6), presence=0, age=0, host="10.0.0.2", port=7440
    )
    look.on_member_list(a_list(other, parts=2), 0.03)
    assert not look.answered
    look.on_member_list(a_list(part=1, parts=2), 0.04)
    assert look.answered == {"a"}
    assert look.result(0.04).expected == {"a", "b"}
    assert not look.is_complete(2.0)  # b has not answered


def test_a_status_that_comes_after_the_member_list_is_an_answer_at_once() -> None:
    look = Discovery(0.0, asks_by_datagram=True)
    look.on_solicit(1, 0.0, wants_status=True)
    look.on_beacon(heard("a", 1), ("10.0.0.1", 7440), 0.01)
    look.on_member_list(a_list(), 0.01)
    assert not look.answered
    for one in status_parts("a", LIFE, 1, CONTENT):
        look.on_status_part(one, 0.02)
    assert look.answered == {"a"}


def test_a_beacon_that_announces_no_status_wakes_the_look_that_dials_then() -> None:
    look = Discovery(0.0, asks_by_datagram=True)
    look.on_solicit(1, 0.0, wants_status=True)
    address = ("10.0.0.1", 7440)
    look.on_beacon(heard("a", 1), address, 0.01)
    assert look.to_link(0.02) == {}
    assert look.on_beacon(replace(heard("a", 0), sequence=2), address, 0.02)
    assert look.to_link(0.02) == {("a", LIFE.hex()): address}


def test_a_robot_whose_member_list_is_lost_is_dialled_and_names_its_members() -> None:
    look = Discovery(0.0, asks_by_datagram=True)
    told_status(look)
    assert look.to_link(0.01 + 0.9 * PARTS_WAIT) == {}
    wait = StatusParts.wait(look.round_trip)
    assert look.to_link(0.01 + wait) == {("a", LIFE.hex()): ("10.0.0.1", 7440)}
    other = Member(robot="b", instance="00" * 6, presence=Presence.ALIVE, age=0.0)
    status = light_status("a", LIFE.hex())
    look.on_view(PeerView(robot="a", status=status, members=(other,)), 0.5)
    assert look.answered == {"a"}
    assert look.result(0.5).expected == {"a", "b"}


@pytest.mark.parametrize("robot", ["b", "a"])
def test_a_status_counts_for_the_robot_and_the_life_that_sent_it(robot: str) -> None:
    look = Discovery(0.0, asks_by_datagram=True)
    look.on_solicit(1, 0.0, wants_status=True)
    look.on_beacon(heard("a", 1), ("10.0.0.1", 7440), 0.01)
    (forged,) = status_parts("a", LIFE, 1, encode(light_status(robot, "00000000000f")))
    with pytest.raises(CodecError):
        look.on_status_part(forged, 0.02)
    assert not look.answered


def test_a_robot_that_has_left_is_not_back_by_a_late_part() -> None:
    look = Discovery(0.0, asks_by_datagram=True)
    look.on_solicit(1, 0.0, wants_status=True)
    look.on_beacon(heard("a", 1), ("10.0.0.1", 7440), 0.01)
    look.on_beacon(replace(heard("a", 1), sequence=2, flags=Flag.LEFT), ("10.0.0.1", 7440), 0.02)
    for one in status_parts("a", LIFE, 1, CONTENT):
        look.on_status_part(one, 0.03)
    assert not look.answered
    assert look.left(0.04) == {"a"}


def test_the_parts_of_invented_robots_fill_a_bounded_table(parts: StatusParts) -> None:
    first, *_ = told(1)
    for number in range(2 * MAX_MEMBERS):
        parts.add(replace(first, robot=f"ghost-{number}"))
    assert len(parts._parts) == MAX_MEMBERS


def test_bytes_that_are_no_status_are_refused() -> None:
    for content in (b"", b"\1", b"\1\xff", b"\7", CONTENT[:-1]):
        with pytest.raises(CodecError):
            decode_status(content)


def test_forged_lives_of_a_robot_leave_bounded_tables() -> None:
    """20,000 lives of one robot answer one solicit; a look keeps the newest 2,048."""
    parts = StatusParts()
    trips = RoundTrips()
    parts.on_asked(1)
    trips.on_solicit(1, 0.0)
    for number in range(20_000):
        life = number.to_bytes(6, "big")
        beacon = replace(heard("r1", 0), instance=life)
        parts.on_beacon(beacon, 0.1)
        trips.on_echo("r1", life.hex(), 1, 0.1, clock_ms=100)
    newest = ("r1", (19_999).to_bytes(6, "big").hex())
    assert len(parts.refusing) == len(trips.clock_leads) == 2 * 1024
    assert newest in parts.refusing
    assert trips.has_answered(*newest)
    assert not trips.has_answered("r1", bytes(6).hex())
