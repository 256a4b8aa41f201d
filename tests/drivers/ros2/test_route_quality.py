"""Which ends in DDS a bridge's route does not serve, by what the bridge tells, without one."""

from __future__ import annotations

import json

import pytest

from swarmd.drivers.ros.diagnosis import Graph
from swarmd.drivers.ros.endpoints import Endpoint
from swarmd.drivers.ros2.dds_bridge import Ros2Dds
from swarmd.drivers.ros2.route_quality import route_fault

BEST_EFFORT, RELIABLE = "BEST_EFFORT", "RELIABLE"


def end(topic: str, reliability: str = RELIABLE, *, is_kept: bool = False) -> bytes:
    """As zenoh-bridge-ros2dds 1.10 tells of a reader or writer."""
    qos: dict[str, object] = {"reliability": {"kind": reliability, "max_blocking_time": 0}}
    if is_kept:
        qos["durability"] = {"kind": "TRANSIENT_LOCAL"}
    return json.dumps({"key": "0110", "topic_name": f"rt{topic}", "qos": qos}).encode()


def graph(topic: str, quality: str, *, is_publisher: bool) -> Graph:
    ends = [Endpoint(is_publisher, topic, "t", "z", quality=quality)]
    return Graph(middleware=Ros2Dds(), endpoints=ends)


@pytest.mark.parametrize(
    ("route", "writer", "differs"),
    [
        ("reliable", end("/odom"), ""),
        ("best effort", end("/odom"), ""),
        ("reliable", end("/odom", BEST_EFFORT), "best effort"),
        ("best effort", end("/odom", BEST_EFFORT), ""),
        ("reliable, transient local", end("/odom"), "volatile"),
        ("reliable, transient local", end("/odom", is_kept=True), ""),
        ("reliable", end("/b/odom", BEST_EFFORT), ""),
        ("reliable", b"garbage", ""),
        ("reliable", b"[]", ""),
        ("reliable", b'{"topic_name": "rt/odom", "qos": {"reliability": 7}}', ""),
    ],
)
def test_a_publisher_must_offer_what_its_route_asks_for(
    route: str, writer: bytes, differs: str
) -> None:
    known = graph("/odom", route, is_publisher=True)
    fault = route_fault([end("/odom", is_kept=True), writer], known, "/odom", is_publisher=True)
    assert bool(fault) is bool(differs)
    assert f"publishes /odom {differs}" in fault or not differs


@pytest.mark.parametrize(
    ("route", "reader", "differs"),
    [
        ("reliable", end("/cmd_vel", BEST_EFFORT), ""),
        ("best effort", end("/cmd_vel"), ""),  # a bridge's writers are reliable
        ("reliable", end("/cmd_vel", is_kept=True), "transient local"),
        ("reliable, transient local", end("/cmd_vel", is_kept=True), ""),
        ("reliable, transient local", end("/cmd_vel"), ""),
    ],
)
@pytest.mark.parametrize("at", ["", "/tb"])
def test_a_route_must_offer_what_a_base_asks_for(
    route: str, reader: bytes, differs: str, at: str
) -> None:
    topic = f"{at}/cmd_vel"  # a bridge's namespace is not in what it tells of DDS
    fault = route_fault(
        [reader], graph(topic, route, is_publisher=False), topic, is_publisher=False
    )
    assert bool(fault) is bool(differs)
    assert f"takes {topic} {differs}" in fault or not differs
