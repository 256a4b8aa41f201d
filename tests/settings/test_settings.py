"""The settings of a daemon: where each comes from, and which one wins."""

from __future__ import annotations

import math
import socket
from pathlib import Path

import pytest

from swarmd.core.errors import ConfigError
from swarmd.core.values import TouchZone, has_places
from swarmd.kit.touch import granted_zones
from swarmd.settings.settings import DaemonSettings, load_daemon_settings

HOME = {"HOME": "/home/someone"}


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.chdir(tmp_path)
    return tmp_path


def load(text: str | None = None, **overrides: object) -> DaemonSettings:
    """Settings from a file `r.yaml` in this folder, if there is text for it."""
    if text is not None:
        Path("r.yaml").write_text(text)
    return load_daemon_settings(Path("r.yaml") if text is not None else None, overrides, HOME)


def test_without_file_and_options_a_robot_is_named_for_its_host(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(socket, "gethostname", lambda: "TB3-07.local")
    settings = load()
    network = settings.network
    assert (settings.id, network.swarm, network.profile) == ("tb3-07", "default", "dev")
    assert (settings.platform.name, settings.file.driver) == ("waffle_pi", "simulated")
    assert settings.state_dir == Path("/home/someone/.local/state/swarmd")
    assert settings.provenance["id"] == "host name"
    assert settings.provenance["swarm"] == "default"


def test_an_invalid_host_name_requires_an_id(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(socket, "gethostname", lambda: "my robot")
    with pytest.raises(ConfigError, match=r"host name .* 'my robot'"):
        load()


def test_command_line_overrides_file_overrides_included_file(folder: Path) -> None:
    (folder / "swarm.yaml").write_text("swarm: lab\nprofile: dev\nroster: [r1, r2]\nlease: 3")
    settings = load("id: r1\nswarm_file: swarm.yaml\nplatform: burger\nlease: 4", id="r2")
    assert (settings.id, settings.network.swarm, settings.network.lease) == ("r2", "lab", 4.0)
    assert settings.roster == ("r1", "r2")
    assert settings.provenance["id"] == "--id"
    assert settings.provenance["lease"] == "r.yaml"
    assert settings.provenance["roster"] == "swarm.yaml"
    assert settings.provenance["seeds"] == "default"


def test_driver_options_of_the_platform_name_it_as_source(folder: Path) -> None:
    def source(text: str = "", **overrides: object) -> str:
        given = {"id": "r1", "platform": "burger", "driver": "ros2dds", **overrides}
        return load(text, **given).provenance["driver_options"]

    assert source() == "platform burger"
    assert source("driver_options: {scan: front}") == "r.yaml, platform burger"
    own = {"scan": "front"}
    assert source(driver_options=own) == "--driver-option, platform burger"
    assert source(driver="simulated") == "default"
    assert source(driver="replay", driver_options=own) == "--driver-option"


def test_an_included_file_may_not_set_the_id(folder: Path) -> None:
    (folder / "swarm.yaml").write_text("swarm: lab\nid: r1")
    with pytest.raises(ConfigError, match=r"^swarm\.yaml: no key 'id'"):
        load("swarm_file: swarm.yaml")


def test_paths_in_a_file_are_relative_to_it(folder: Path) -> None:
    (folder / "etc").mkdir()
    (folder / "etc/swarm.yaml").write_text("swarm: lab")
    (folder / "etc/mine.yaml").write_text("extends: burger\nlimits: {linear: 0.1}")
    config = folder / "etc/r.yaml"
    config.write_text(
        "id: r1\nswarm_file: swarm.yaml\nplatform: mine.yaml\nstate_dir: state\nplugin_dir: own"
    )
    settings = load_daemon_settings(config, {}, HOME)
    assert (settings.network.swarm, settings.platform.limits.linear) == ("lab", 0.1)
    assert settings.platform_name == str(folder / "etc/mine.yaml")
    assert settings.state_dir == folder / "etc/state"
    assert settings.plugin_dir == folder / "etc/own"


def test_paths_on_the_command_line_are_relative_to_the_working_directory(folder: Path) -> None:
    (folder / "etc").mkdir()
    config = folder / "etc/r.yaml"
    config.write_text("id: r1\nstate_dir: state\nplugin_dir: own")
    settings = load_daemon_settings(config, {"state_dir": "here", "plugin_dir": "p"}, HOME)
    assert settings.state_dir == Path("here")
    assert settings.plugin_dir == Path("p")


def test_state_dir_follows_xdg_state_home() -> None:
    settings = load_daemon_settings(None, {"id": "r1"}, {**HOME, "XDG_STATE_HOME": "/state"})
    assert settings.state_dir == Path("/state/swarmd")
    relative = load_daemon_settings(None, {"id": "r1"}, {**HOME, "XDG_STATE_HOME": "state"})
    assert relative.state_dir == Path("/home/someone/.local/state/swarmd")


def test_a_service_keeps_its_state_where_systemd_says() -> None:
    environ = {**HOME, "XDG_STATE_HOME": "/state", "STATE_DIRECTORY": "/var/lib/swarmd:/other"}
    settings = load_daemon_settings(None, {"id": "r1"}, environ)
    assert settings.state_dir == Path("/var/lib/swarmd")


def test_without_a_home_it_asks_for_a_state_dir() -> None:
    with pytest.raises(ConfigError, match="give --state-dir"):
        load_daemon_settings(None, {"id": "r1"}, {})
    assert load_daemon_settings(None, {"id": "r1", "state_dir": "/x"}, {}).state_dir == Path("/x")


def test_driver_options_add_up_from_platform_file_and_command_line(folder: Path) -> None:
    (folder / "mine.yaml").write_text(
        "extends: burger\ndrivers: {simulated: {endpoint: weak, a: 1, deep: {x: 1, y: 2}}}"
    )
    settings = load(
        "id: r1\nplatform: mine.yaml\ndriver_options: {endpoint: file, deep: {y: 3}}",
        driver_options={"b": 2},
    )
    assert settings.driver_options == {"endpoint": "file", "a": 1, "b": 2, "deep": {"x": 1, "y": 3}}


def test_patterns_may_need_what_a_driver_reads(folder: Path) -> None:
    reading = "{topic: /temp, type: sensor_msgs/Temperature, field: temperature}"
    text = f"driver: ros2dds\ndriver_options: {{readings: {{temperature: {reading}}}}}"
    assert "reading:temperature" in load(text).platform.provides


def test_patterns_may_need_places_of_peers_from_shared_poses_or_detected_tags(
    folder: Path,
) -> None:
    distance, bearing, heading = (f"neighbors.{one}" for one in ("distance", "bearing", "heading"))
    posed = load("driver: ros2dds\ndriver_options: {shared_pose: /pose}").platform.provides
    assert posed >= {"pose", distance, bearing, heading}
    flown = load("platform: crazyflie\ndriver: crazyflie\ndriver_options: {pose_frame: hall}")
    assert flown.platform.provides >= {"pose", distance, bearing, heading}
    camera = "topic: /tags, type: apriltag_msgs/AprilTagDetectionArray, robots: {'7': r2}"
    near = "driver: ros2dds\ndriver_options: {detections: {front: {%s}}}"
    assert not has_places(load(near % camera).platform)  # that follows from the size
    seen = load(near % f"{camera}, size: 0.2")
    assert seen.platform.provides >= {"detections", distance, bearing}
    assert heading not in seen.platform.provides
    for platform, is_known in (("burger", True), ("thymio", False)):
        known = load(f"driver: ros2dds\nplatform: {platform}").platform
        assert ({"kin", distance, bearing, heading} <= known.provides) is is_known
        assert not has_places(known)
    board = "extends: burger\nprovides: [scan, odometry, neighbors.distance, neighbors.bearing]"
    (folder / "board.yaml").write_text(board)
    with_board = load("id: r1\nplatform: board.yaml").platform
    assert has_places(with_board)  # kin would name some peers alone
    assert "kin" not in with_board.provides
    typed = "extends: burger\nprovides: [scan, odometry, pose]"  # as of a drone
    (folder / "mine.yaml").write_text(typed)
    assert load("id: r1\nplatform: mine.yaml").platform.provides >= {distance, bearing, heading}


def test_patterns_may_need_each_sensor_of_an_entry_and_their_mean(folder: Path) -> None:
    array = "{topic: x, type: std_msgs/Float32MultiArray, field: data.*, count: 2}"
    topics = "{topic: [a, b, c], type: std_msgs/Float32}"
    text = f"driver: ros2dds\ndriver_options: {{readings: {{ground: {array}, light: {topics}}}}}"
    words = load(text).platform.provides
    ground = {"reading:ground", "reading:ground_1", "reading:ground_2"}
    assert words >= ground | {"reading:light", "reading:light_3"}
    assert not words & {"reading:ground_3", "reading:light_4"}


def test_a_hazard_of_each_number_reaches_the_driver(folder: Path) -> None:
    """As on the page of the TurtleBot 4."""
    entry = '{topic: hazard_detection, means: {"1": bump, "2": cliff}}'
    settings = load(f"driver: ros2dds\ndriver_options: {{hazards: {{base: {entry}}}}}")
    hazards = settings.driver_options["hazards"]
    assert isinstance(hazards, dict)
    assert hazards["base"] == {"topic": "hazard_detection", "means": {"1": "bump", "2": "cliff"}}


def test_pattern_parameters_come_in_layers_weakest_first(folder: Path) -> None:
    (folder / "mine.yaml").write_text("extends: burger\npatterns: {drive: {linear: 0.1}}")
    settings = load(
        "id: r1\n"
        "platform: mine.yaml\n"
        "labels: {red: [r1], blue: [r2], fast: [r2, r1]}\n"
        "parameters:\n"
        "  labels:\n"
        "    fast: {drive: {linear: 0.2}}\n"
        "    blue: {drive: {linear: 0.9}}\n"
        "  robots:\n"
        "    r1: {drive: {angular: 0.3}, attraction: {range_max: 1}}\n"
    )
    assert settings.labels == ("red", "fast")
    assert settings.parameters.layers("drive", settings.labels) == (
        ("platform", {"linear": 0.1}),
        ("label fast", {"linear": 0.2}),
        ("robot", {"angular": 0.3}),
    )
    layers = settings.parameters.layers
    assert layers("attraction", settings.labels) == (("robot", {"range_max": 1}),)
    assert settings.parameters.layers("dispersion", settings.labels) == ()


def test_a_robots_file_can_change_and_revoke_grants(folder: Path) -> None:
    (folder / "swarm.yaml").write_text(
        "touch: {push: {half_width_deg: 20, speed: 0.1}, dock: {half_width_deg: 5, speed: 0.02}}"
    )
    settings = load("id: r1\nswarm_file: swarm.yaml\ntouch: {dock: null, push: {speed: 0.05}}")
    assert granted_zones(settings.robot.touch) == {"push": TouchZone(0.0, math.radians(20.0), 0.05)}
    assert settings.provenance["touch"] == "r.yaml"


def test_a_source_is_never_longer_than_a_status_can_name(folder: Path) -> None:
    label = "l" * 63
    settings = load(
        f"id: r1\nlabels: {{{label}: [r1]}}\n"
        f"parameters: {{labels: {{{label}: {{drive: {{linear: 0.1}}}}}}}}"
    )
    ((source, _),) = settings.parameters.layers("drive", settings.labels)
    assert len(source) == 64


@pytest.mark.parametrize(
    ("text", "fault"),
    [
        ("id: TB3", "r.yaml: id is 'TB3'; expected 1 to 63 of a-z"),
        ("id: 7", "r.yaml: id is 7; expected text or null"),
        ("id: r1\nplatform: wafle_pi", "no platform 'wafle_pi'; did you mean 'waffle_pi'?"),
        ("id: r1\ndriver_options: {x: .inf}", "r.yaml: driver_options.x is inf; expected"),
        ("id: r1\nplatform: none.yaml", "none.yaml: cannot be read: No such file"),
    ],
)
@pytest.mark.usefixtures("folder")
def test_refuses_in_one_line(text: str, fault: str) -> None:
    with pytest.raises(ConfigError) as caught:
        load(text)
    assert str(caught.value).startswith(fault)
    assert "\n" not in str(caught.value)


def test_die_with_parent_is_not_a_key_of_files(folder: Path) -> None:
    assert load("id: r1", die_with_parent=7).die_with_parent == 7
    with pytest.raises(ConfigError, match="no key 'die_with_parent'"):
        load("id: r1\ndie_with_parent: 7")


def test_the_example_in_config_can_be_read() -> None:
    example = Path(__file__).parents[2] / "config/swarm.yaml"
    settings = load_daemon_settings(example, {"id": "tb3-01", "platform": "burger"}, HOME)
    assert settings.id in settings.roster
    assert settings.parameters.layers("attraction", settings.labels)


def test_ranges_are_names_in_roster_and_labels(folder: Path) -> None:
    settings = load(
        'id: r02\nroster: ["r[01-03]", x]\nlabels: {red: ["r[02-03]", r02], blue: ["r[01,03]"]}'
    )
    assert settings.roster == ("r01", "r02", "r03", "x")
    assert settings.labels == ("red",)
    assert settings.file.members == {"red": ("r02", "r03"), "blue": ("r01", "r03")}


@pytest.mark.parametrize(
    ("text", "fault"),
    [
        ('roster: ["r[01-03]", r02]', "'r02' twice"),
        ('roster: ["r[03-01]"]', "rising"),
        ('roster: ["r[01-03]"]\nlabels: {red: ["r[03-04]"]}', "r04"),
        ('labels: {red: ["r[x]"]}', r"\[x\]"),
    ],
)
def test_ranges_that_cannot_be_are_named(folder: Path, text: str, fault: str) -> None:
    with pytest.raises(ConfigError, match=fault):
        load(f"id: r01\n{text}")
