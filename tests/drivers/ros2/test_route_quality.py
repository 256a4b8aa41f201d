"""Which ends in DDS a bridge's route does not serve, by what the bridge tells, without one."""

from __future__ import annotations

import json

import pytest

from swarmd.drivers.ros.diagnosis import Graph
from swarmd.drivers.ros.endpoints import Endpoint
from swarmd.drivers.ros2.admin_space import NodeList, route_faults
from swarmd.drivers.ros2.dds_bridge import Ros2Dds

BEST_EFFORT, RELIABLE = "BEST_EFFORT", "RELIABLE"


def end(topic: str, reliability: object = RELIABLE, *, is_kept: bool = False) -> bytes:
    """As zenoh-bridge-ros2dds 1.10 tells of a reader or writer."""
    qos: dict[str, object] = {"reliability": {"kind": reliability, "max_blocking_time": 0}}
    if is_kept:
        qos["durability"] = {"kind": "TRANSIENT_LOCAL"}
    told = {"key": "0110", "topic_name": f"rt{topic}", "type_name": "t", "qos": qos}
    return json.dumps(told).encode()


def fault(
    topic: str, route: str, *ends: bytes, is_publisher: bool, namespace: str = "/"
) -> str | None:
    """Why messages of a topic do not pass that has this route, and these ends in DDS."""
    kind = "writer" if is_publisher else "reader"
    config = json.dumps({"namespace": namespace, "nodename": "bridge"}).encode()
    told = {f"@/z/ros2/dds/01/{kind}/{n}/rt/x": one for n, one in enumerate(ends)}
    listed = NodeList()
    listed.take({"@/z/ros2/config": config, **told}, (), 0.0)
    routes = [Endpoint(is_publisher, topic, "t", "z", quality=route)]
    return route_faults(listed.dds, Graph(middleware=Ros2Dds(), endpoints=routes)).get(topic)


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
        ("reliable", end("/odom", 7), ""),
    ],
)
def test_a_publisher_must_offer_what_its_route_asks_for(
    route: str, writer: bytes, differs: str
) -> None:
    found = fault("/odom", route, end("/odom", is_kept=True), writer, is_publisher=True)
    assert bool(found) is bool(differs)
    assert not differs or f"publishes /odom {differs}" in (found or "")


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
    found = fault(topic, route, reader, is_publisher=False, namespace=at or "/")
    assert bool(found) is bool(differs)
    assert not differs or f"takes {topic} {differs}" in (found or "")


def test_who_only_reads_a_sensor_is_no_publisher_of_another_quality() -> None:
    reader = end("/odom", BEST_EFFORT)
    assert fault("/odom", "reliable", reader, is_publisher=False) is None
