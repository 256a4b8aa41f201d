"""Keys, attachments and tokens against published examples.

ros2/rmw_zenoh `docs/design.md` (keys, attachment, tokens of the talker and the listener) and
eclipse-zenoh/zenoh-plugin-ros2dds `liveliness_mgt.rs`.
"""

from __future__ import annotations

import struct

import pytest
from zenoh.ext import Int64, z_serialize

from swarmd.core.errors import CodecError
from swarmd.drivers.ros import messages
from swarmd.drivers.ros.endpoints import Endpoint
from swarmd.drivers.ros2.dds_bridge import Ros2Dds
from swarmd.drivers.ros2.key_scheme import TopicEnd
from swarmd.drivers.ros2.rmw_zenoh import NO_HASH, TRIGGER_HASH, RmwZenoh, gid_of
from tests.drivers.ros2.robots import HASHES

STRING = "std_msgs::msg::dds_::String_"
STRING_HASH = "RIHS01_df668c740482bbd48fb39d76a70dfd4bd59db1288021743503259e948f6b1a18"
TALKER = (
    f"@ros2_lv/2/8b20917502ee955ac4476e0266340d5c/0/10/MP/%/%/talker/%chatter/{STRING}"
    f"/{STRING_HASH}/::,7:,:,:,,"
)
LISTENER = (
    f"@ros2_lv/2/aac3178e146ba6f1fc6e6a4085e77f21/0/10/MS/%/%/listener/%chatter/{STRING}"
    f"/{STRING_HASH}/::,10:,:,:,,"
)
LASER = "sensor_msgs::msg::dds_::LaserScan_"
SCAN = TopicEnd("/scan", messages.LaserScan, is_publisher=False, is_reliable=False, depth=1)
COMMAND = TopicEnd("/cmd_vel", messages.Twist, is_publisher=True, is_reliable=True, depth=1)


def scheme(domain: int = 0) -> RmwZenoh:
    return RmwZenoh(domain, "/cmd_vel")


def test_published_tokens_are_understood() -> None:
    end = scheme().parse_token(TALKER)
    zid = "8b20917502ee955ac4476e0266340d5c"
    assert end == Endpoint(True, "/chatter", "std_msgs/msg/String", zid, 2, "/talker", "reliable")
    listener = scheme().parse_token(LISTENER)
    assert listener is not None
    assert (listener.is_publisher, listener.node) == (False, "/listener")


@pytest.mark.parametrize(
    "token",
    [
        "@ros2_lv/2/aac3178e146ba6f1fc6e6a4085e77f21/0/0/NN/%/%/listener",
        "@ros2_lv/x/aa/0/10/MS/%/%/listener/%chatter/a/b/c",
        "@ros2_lv/2/aa/0/10/MS/%/%/listener",
        "@ros2_lv",
        "",
    ],
)
def test_other_tokens_announce_no_topic(token: str) -> None:
    assert scheme().parse_token(token) is None


def test_our_tokens_have_the_published_form_and_are_understood_again() -> None:
    ours = scheme(2)
    node, subscription, publisher = ours.tokens("aac3178e146ba6f1fc6e6a4085e77f21", [SCAN, COMMAND])
    assert node == "@ros2_lv/2/aac3178e146ba6f1fc6e6a4085e77f21/0/0/NN/%/%/swarmd"
    assert [part.count("/") for part in (subscription, publisher)] == [LISTENER.count("/")] * 2
    assert subscription.split("/")[:9] == [*LISTENER.split("/")[:4], "1", "MS", "%", "%", "swarmd"]
    end = ours.parse_token(publisher)
    assert end is not None
    assert (end.is_publisher, end.topic, end.type) == (True, "/cmd_vel", "geometry_msgs/msg/Twist")
    assert publisher.endswith(f"/{HASHES['Twist']}/::,1:,:,:,,")
    assert subscription.endswith(f"/{HASHES['LaserScan']}/2::,1:,:,:,,")


def test_the_gid_is_the_tokens_hash() -> None:
    # XXH3-128 of the empty text is 99aa06d3014798d86001c324468d497f (xxHash's own test vector);
    # rmw_zenoh copies the low half, then the high one, as they lie in memory.
    assert gid_of("").hex() == "7f498d4624c30160" + "d8984701d306aa99"
    assert gid_of(TALKER) != gid_of(LISTENER)


def test_the_attachment_is_sequence_time_and_gid() -> None:
    ours = scheme()
    *_, token = ours.tokens("ab", [COMMAND])
    first, second = ours.attachment(token), ours.attachment(token)
    assert first is not None
    assert second is not None
    assert len(first) == 33
    sequence, time, length, gid = struct.unpack("<qqB16s", first)
    assert (sequence, length, gid) == (1, 16, gid_of(token))
    assert struct.unpack("<qqB16s", second)[0] == 2
    assert time > 1_600_000_000 * 10**9
    # What Zenoh's own serialisation makes of the same three, as rmw_zenoh uses it.
    assert first == z_serialize((Int64(sequence), Int64(time), gid)).to_bytes()


@pytest.mark.parametrize(
    ("key", "complaint"),
    [
        (f"0/bot/scan/{LASER}/{HASHES['LaserScan']}", ""),
        (f"0/bot/scan/{LASER}/{NO_HASH}", ""),
        (f"0/bot/scan/{LASER}/RIHS01_0000", "type hash RIHS01_0000, which no distribution has"),
        (f"0/bot/scan/sensor_msgs::msg::dds_::PointCloud2_/{NO_HASH}", "carries sensor_msgs/msg/P"),
        (f"1/bot/scan/{LASER}/{NO_HASH}", "sent on key"),
        (f"0/bot/scan/front/{LASER}/{NO_HASH}", "sent on key"),
        ("0/bot/scan/**", "sent on key"),
        (f"0/bot/scan/ok\nok/{NO_HASH}", "sent on key '0/bot/scan/ok\\nok/"),
        ("**", "sent on key"),
    ],
)
def test_type_and_hash_of_a_key_are_checked(key: str, complaint: str) -> None:
    fault = scheme().key_fault(key, "/bot/scan", messages.LaserScan)
    assert complaint in fault
    assert bool(fault) == bool(complaint)


def test_commands_go_out_as_the_robots_distribution_names_them() -> None:
    ours = scheme(3)
    prefix = "3/cmd_vel/geometry_msgs::msg::dds_::Twist_/"
    assert ours.key("/cmd_vel", messages.Twist) == prefix + HASHES["Twist"]
    assert ours.key_fault(f"3/scan/{LASER}/{NO_HASH}", "/scan", messages.LaserScan) == ""
    assert ours.key("/cmd_vel", messages.Twist) == prefix + NO_HASH
    assert set(ours.command_keys("/cmd_vel", messages.Twist)) == {
        prefix + HASHES["Twist"],
        prefix + NO_HASH,
    }


def test_foreign_commands_do_not_reveal_the_robots_distribution() -> None:
    ours = scheme()
    mine = ours.key("/cmd_vel", messages.Twist)
    for key in ours.command_keys("/cmd_vel", messages.Twist):  # a watchdog's zeros go out on each
        assert ours.key_fault(key, "/cmd_vel", messages.Twist) == ""
        assert ours.key("/cmd_vel", messages.Twist) == mine


def test_the_bridges_keys_are_topics_without_their_first_slash() -> None:
    ours = Ros2Dds()
    assert ours.subscription_key("/bot1/scan") == "bot1/scan"
    assert ours.command_keys("/cmd_vel", messages.Twist) == ("cmd_vel",)
    assert ours.key_fault("bot1/scan", "/bot1/scan", messages.LaserScan) == ""
    assert ours.key_fault("**", "/bot1/scan", messages.LaserScan)
    assert ours.attachment() is None


def test_the_announcements_of_a_bridge_are_read() -> None:
    """As zenoh-bridge-ros2dds 1.10 sends them: the type's hash follows the quality of service."""
    zid, hashed = "ad21b741805add91719f8b8dd4f837a7", "typehash=RIHS01_9c45bf16fe0983d8;"
    end = Ros2Dds().parse_token(
        f"@/{zid}/@ros2_lv/MS/cmd_vel/geometry_msgs§msg§Twist/:1::0,10:{hashed}"
    )
    assert end == Endpoint(False, "/cmd_vel", "geometry_msgs/msg/Twist", zid, quality="reliable")
    end = Ros2Dds().parse_token(
        f"@/{zid}/@ros2_lv/MP/bot1§scan/sensor_msgs§msg§LaserScan/:::1,5"  # of Humble
    )
    assert end == Endpoint(True, "/bot1/scan", "sensor_msgs/msg/LaserScan", zid)
    for other in (f"@/{zid}/@ros2_lv", f"@/{zid}/@ros2_lv/SS/a/b"):
        assert Ros2Dds().parse_token(other) is None


def test_a_topic_is_received_in_its_domain_with_any_type_and_hash() -> None:
    assert scheme(3).subscription_key("/bot/scan") == "3/bot/scan/*/*"


@pytest.mark.parametrize("is_base_old", [False, True])
def test_commands_have_the_form_of_the_base_beside_a_lidar_of_another_distribution(
    is_base_old: bool,
) -> None:
    """The node of the odometry takes the commands; Humble's keys have no hash."""
    made = scheme()
    odometry, laser = (
        f"0/{topic}/{package}::msg::dds_::{kind}_/{HASHES[kind] if has_hash else NO_HASH}"
        for topic, package, kind, has_hash in (
            ("odom", "nav_msgs", "Odometry", not is_base_old),
            ("scan", "sensor_msgs", "LaserScan", is_base_old),
        )
    )
    wanted = NO_HASH if is_base_old else HASHES["Twist"]
    for _ in range(2):
        assert not made.key_fault(odometry, "/odom", messages.Odometry)
        assert not made.key_fault(laser, "/scan", messages.LaserScan)
        assert made.key("/cmd_vel", messages.Twist).rpartition("/")[2] == wanted


@pytest.mark.parametrize("hashed", [TRIGGER_HASH, NO_HASH])
@pytest.mark.parametrize("kind", ["std_srvs::srv::dds_::Empty_", "x::Trigger_", "*"])
def test_a_call_of_another_type_is_none_of_a_trigger(hashed: str, kind: str) -> None:
    """Humble's placeholder is the same for each type, so that the type itself decides."""
    attachment = struct.pack("<qqB16s", 7, 2_000_000_000, 16, b"c" * 16)
    key = f"0/swarmd/reset/std_srvs::srv::dds_::Trigger_/{hashed}"
    assert RmwZenoh(0, "/cmd_vel").call_stamp(key, attachment) == 2.0
    with pytest.raises(CodecError):
        RmwZenoh(0, "/cmd_vel").call_stamp(f"0/swarmd/reset/{kind}/{hashed}", attachment)
