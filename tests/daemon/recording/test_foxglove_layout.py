"""The layout for Foxglove against a recording of a daemon: each topic and field is there."""

from __future__ import annotations

import json
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest
from mcap.reader import make_reader
from mcap_ros2.decoder import DecoderFactory

from tests.support.processes import wait_until
from tests.swarm.conftest import swarm

if TYPE_CHECKING:
    from tests.swarm.conftest import Swarm

__all__ = ["swarm"]
pytestmark = pytest.mark.integration

LAYOUT = Path(__file__).resolve().parents[3] / "examples" / "foxglove" / "recording.json"


def named(panel: dict[str, Any]) -> Iterator[str]:
    """The topics of a panel, with the path of a field."""
    yield from panel.get("topics", ())
    yield from (one["value"] for one in panel.get("paths", ()))
    yield from (panel[key] for key in ("topicToRender", "topicPath") if key in panel)


def frames(panel: dict[str, Any]) -> set[tuple[str, str]]:
    """The topics that a panel draws in a frame, and that frame."""
    return {(topic, panel["fixedFrame"]) for topic in panel.get("topics", ())}


def leaves(layout: Any) -> list[str]:
    """The panels that a layout places."""
    if isinstance(layout, str):
        return [layout]
    return [*leaves(layout["first"]), *leaves(layout["second"])]


def test_the_layout_places_each_of_its_panels() -> None:
    found = json.loads(LAYOUT.read_text())
    assert sorted(leaves(found["layout"])) == sorted(found["configById"])
    kinds = {name.partition("!")[0] for name in found["configById"]}
    assert kinds >= {"3D", "Plot", "StateTransitions", "RosOut"}


def test_each_field_of_the_layout_is_in_a_recording(swarm: Swarm) -> None:
    body = swarm.body("tb3-01")
    swarm.start("tb3-01", body, {"recording": {"from_start": True}})
    swarm.run_drive("tb3-01")
    body.wait_moving()
    assert swarm.ctl("stop", "--all").code == 0
    assert swarm.ctl("record", "stop", "--all").code == 0
    folder = swarm.folder / "state" / swarm.name / "tb3-01" / "recordings"
    wait_until(lambda: bool(list(folder.glob("*.index.json"))), "the recording is finished")
    (file,) = folder.glob("*.mcap")
    with file.open("rb") as stream:
        reader = make_reader(stream, decoder_factories=[DecoderFactory()])
        last = {channel.topic: one for _, channel, _, one in reader.iter_decoded_messages()}

    panels = json.loads(LAYOUT.read_text())["configById"].values()
    for path in {path for panel in panels for path in named(panel)}:
        topic, *fields = path.split(".")
        value = last[topic]
        for field in fields:
            value = getattr(value, field)
        assert value is not None, path
    for topic, frame in {pair for panel in panels for pair in frames(panel)}:
        assert last[topic].header.frame_id == frame
