"""The codec of datagrams: what fits, what is refused, and what other versions may send."""

from __future__ import annotations

import msgspec
import pytest
from msgspec import structs
from msgspec.structs import replace

from swarmd.core.errors import CodecError
from swarmd.core.kin_message import KinMessage
from swarmd.core.messages import Body
from swarmd.link import datagram
from swarmd.link.datagram import (
    ANY_SWARM,
    MAX_DATAGRAM,
    Ack,
    Beacon,
    BodyReport,
    Kind,
    MemberReport,
    Solicit,
    Stop,
    Swarm,
    in_parts,
    pack,
    tag_of,
    unpack,
)

TAG = tag_of("field", "lab")
BODY = Body(
    platform="waffle_pi", surface_speed=0.4, radius=0.25, scan_plane=0.131, lowest=0.01,
    highest=0.141,
)  # fmt: skip
BEACON = Beacon(
    robot="tb3-01",
    instance=b"abcdef",
    sequence=70_000,
    wire=1,
    state=1,
    revision=12,
    digests=(b"123456", b"123456"),
    body=BodyReport.of(BODY),
)


def body(kind: Kind, *fields: object, signature: bytes = b"", tag: bytes = TAG) -> bytes:
    """A datagram with these fields, as another version may send it."""
    content = msgspec.msgpack.encode(list(fields))
    head = b"SWMD" + bytes([kind]) + tag + len(content).to_bytes(2, "big")
    return head + content + signature


def test_beacon_has_at_most_ninety_bytes_and_is_read_back() -> None:
    payload = pack(TAG, BEACON)
    assert 60 <= len(payload) <= 90
    assert unpack(TAG, payload) == BEACON


def test_fields_of_later_versions_and_a_signature_are_ignored() -> None:
    fields = [getattr(BEACON, name) for name in Beacon.__struct_fields__]
    newer = body(Kind.BEACON, *fields, {"new": 1}, signature=b"s" * 64)
    assert unpack(TAG, newer) == BEACON


def test_fields_that_an_earlier_version_does_not_send_have_defaults() -> None:
    older = body(Kind.BEACON, "tb3-01", b"abcdef", 70_000, 1, 1, 12)
    assert unpack(TAG, older) == msgspec.structs.replace(BEACON, digests=(), body=None)


def test_a_body_is_told_in_millimetres_and_never_slower_or_smaller_than_it_is() -> None:
    assert BodyReport.of(BODY).body == BODY
    odd = structs.replace(BODY, surface_speed=0.3001, radius=0.1351, scan_plane=None)
    told = BodyReport.of(odd).body
    assert (told.surface_speed, told.radius, told.scan_plane) == (0.301, 0.136, None)
    exact = [structs.replace(BODY, surface_speed=n / 100.0) for n in range(200)]
    assert [BodyReport.of(body).body for body in exact] == exact


def test_stop_with_three_fields_is_read() -> None:
    """A stop without further fields is for every robot, and as new as it arrives."""
    stop = unpack(TAG, body(Kind.STOP, "id", "estop", "anna"))
    assert isinstance(stop, Stop)
    assert (stop.id, stop.verb, stop.operator) == ("id", "estop", "anna")
    assert (stop.targets, stop.scope, stop.reason) == (None, "swarm", "")
    assert (stop.age, stop.hops, stop.repeated) == (0, 0, 0)
    assert (stop.origin, stop.counter, stop.clock, stop.issued) == (b"", 0, "", 0.0)


def test_an_ack_with_five_fields_is_of_the_robot_itself_whose_base_rests() -> None:
    ack = unpack(TAG, body(Kind.ACK, "id", "tb3-01", b"abcdef", 4, "applied"))
    assert isinstance(ack, Ack)
    assert (ack.refusal, ack.text, ack.via, ack.proof) == (None, "", "", b"")
    assert ack.is_moving is False


def test_other_swarms_profiles_and_unknown_kinds_are_skipped() -> None:
    payload = pack(TAG, BEACON)
    assert unpack(tag_of("field", "other"), payload) is None
    assert unpack(tag_of("dev", "lab"), payload) is None
    assert unpack(TAG, payload[:4] + b"\xff" + payload[5:]) is None


def test_a_solicit_of_any_swarm_is_read_and_a_stop_of_any_swarm_is_not() -> None:
    assert unpack(TAG, pack(ANY_SWARM, Solicit(echo=5))) == Solicit(echo=5)
    named = Swarm(swarm="lab", profile="field", robot="r1")
    assert unpack(TAG, pack(ANY_SWARM, named)) == named
    assert unpack(TAG, pack(ANY_SWARM, Stop(id="i", verb="stop", operator="x"))) is None


@pytest.mark.parametrize(
    "payload",
    [
        b"",
        b"SWMD",
        b"x" * 40,
        pack(TAG, BEACON)[:-1],
        pack(TAG, BEACON) + b"x" * MAX_DATAGRAM,
        body(Kind.BEACON),
        body(Kind.BEACON, "Wild/*", b"abcdef", 1, 1, 1, 1),
        body(Kind.BEACON, "r1\n", b"abcdef", 1, 1, 1, 1),
        body(Kind.BEACON, "r1", b"short", 1, 1, 1, 1),
        body(Kind.BEACON, "r1", b"abcdef", -1, 1, 1, 1),
        body(Kind.BEACON, "r1", b"abcdef", 1.5, 1, 1, 1),
        body(Kind.STOP, "id", "run", "anna"),
    ],
)
def test_malformed_datagrams_are_refused(payload: bytes) -> None:
    with pytest.raises(CodecError):
        unpack(TAG, payload)


def test_a_datagram_that_is_too_large_is_not_sent() -> None:
    with pytest.raises(CodecError):
        pack(TAG, Stop(id="i", verb="stop", operator="a", targets=("r" * 63,) * 30))


def test_lists_of_many_members_are_cut_into_datagrams_that_fit() -> None:
    members = tuple(
        MemberReport(
            robot=f"robot-{n}", instance=b"abcdef", presence=0, age=10, host="10.0.0.1", port=1
        )
        for n in range(150)
    )
    roster = tuple(f"robot-{n}" for n in range(100))
    parts = in_parts(members, roster=roster)
    assert tuple(one for some, _ in parts for one in some) == members
    assert tuple(name for _, names in parts for name in names) == roster
    for number, (some, names) in enumerate(parts):
        word = datagram.MemberList(
            robot="r" * 63,
            instance=b"abcdef",
            members=some,
            part=number,
            parts=len(parts),
            echo=2**50,
            roster=names,
        )
        assert len(pack(TAG, word)) <= MAX_DATAGRAM


def test_a_place_has_at_most_sixty_bytes_and_is_read_back() -> None:
    place = datagram.Place(
        robot="tb3-01", instance=b"abcdef", sent=10**9, age=105, frame="mocap", x=-3_500,
        y=12_000, error=51, heading=-3_142,
    )  # fmt: skip
    payload = pack(TAG, place)
    assert 40 <= len(payload) <= 60
    assert unpack(TAG, payload) == place
    head = ("r1", b"abcdef", 1, 1)
    assert unpack(TAG, body(Kind.PLACE, *head, "map", 0, 0, 0)) is not None
    for wrong in (("", 0, 0, 0), ("map", 2**40, 0, 0), ("map", 0.5, 0, 0), ("map", 0, 0, -1),
                  ("map", 0, 0, 0, 3_143), ("map", 0, 0, 0, 0.5)):  # fmt: skip
        with pytest.raises(CodecError):
            unpack(TAG, body(Kind.PLACE, *head, *wrong))


TOLD = KinMessage(7, 10**9, -3_500, 12_000, -3_142, b"\x04\xb0\x06\x23" * 8, True)


def test_a_kin_report_has_at_most_90_bytes_and_is_read_back() -> None:
    """The sizes of docs/evidence/network.md."""
    report = datagram.KinReport(robot="tb3-01", instance=b"abcdef", message=TOLD)
    assert len(pack(TAG, report)) <= 90
    assert len(pack(TAG, replace(report, message=replace(TOLD, objects=b"")))) <= 55
    assert unpack(TAG, pack(TAG, report)) == report


@pytest.mark.parametrize(
    "wrong",
    [
        (),
        (7, 1000, 0, 0),
        (-1, 1000, 0, 0, 0),
        (7, -1, 0, 0, 0),
        (7, 2**63, 0, 0, 0),
        (7, 1000, 2**62, 0, 0),
        (7, 1000, 0, 0.5, 0),
        (7, 1000, 0, None, 0),
        (7, 1000, 0, 0, 3_143),
        (7, 1000, 0, 0, 0, 5),
        (7, 1000, 0, 0, 0, ((1, 0),)),
        (7, 1000, 0, 0, 0, bytes(33)),
        (7, 1000, 0, 0, 0, "text"),
        (7, 1000, 0, 0, 0, None),
        (7, 1000, 0, 0, 0, b"", 2),
    ],
)
def test_a_kin_report_beyond_its_bounds_is_refused(wrong: tuple[object, ...]) -> None:
    assert unpack(TAG, body(Kind.KIN, "r1", b"abcdef", (7, 1000, 0, 0, 0))) is not None
    with pytest.raises(CodecError):
        unpack(TAG, body(Kind.KIN, "r1", b"abcdef", wrong))


def test_a_kin_report_of_a_later_version_is_read() -> None:
    later = (*structs.astuple(TOLD), "new")
    read = unpack(TAG, body(Kind.KIN, "r1", b"abcdef", later, 5))
    assert read == datagram.KinReport(robot="r1", instance=b"abcdef", message=TOLD)


def test_places_without_and_with_a_heading_are_read_by_both_versions() -> None:
    head = ("r1", b"abcdef", 1, 1)
    older = unpack(TAG, body(Kind.PLACE, *head, "map", 0, 0, 0))
    assert isinstance(older, datagram.Place)
    assert older.heading is None
    newer = datagram.Place(
        robot="r1", instance=b"abcdef", sent=1, age=1, frame="map", x=2, y=3, error=4, heading=500
    )
    fields = msgspec.msgpack.decode(pack(TAG, newer)[15:])  # behind the head
    # A version without headings reads the first eight fields, in this order, and ignores the rest.
    assert fields == ["r1", b"abcdef", 1, 1, "map", 2, 3, 4, 500]
