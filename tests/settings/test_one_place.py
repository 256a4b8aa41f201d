"""A new setting is a field of `RobotSettings` or `BarrierSettings`, what uses it, and its page.

`reached` adds a field to the source of each of these modules, in a process of its own, and writes
one key to swarm.yaml and to a scenario, and the other one to a platform. All other code is as it
stands: whatever copies settings by name loses the new one.
"""

from __future__ import annotations

import json
import re
import subprocess
import sys
from pathlib import Path

import pytest

from swarmd.settings.robot_settings import RobotSettings

ROOT = Path(__file__).parents[2]
BELOW = "    on_low_battery: LowBatterySettings | None = None\n"
ADDED = "    patience: Annotated[float, Meta(gt=0.0, le=9.0)] = 1.0\n"
WRITTEN = 2.5
SQUARE = [[-5.0, -5.0], [5.0, -5.0], [5.0, 5.0], [-5.0, 5.0]]
KEYS = f"patience: {WRITTEN}\nfence: {{frame: world, polygon: {SQUARE}}}\n"
BARRIER_BELOW = "    walls_stand: WallsStand | None = None\n"
BARRIER_ADDED = "    caution: Annotated[float, Meta(ge=0.0, le=1.0)] = 0.0\n"
CAUTION = 0.25
PLATFORM = f"{{extends: burger, protection: {{barrier: {{caution: {CAUTION}}}}}}}"
WITH_FIELDS = f"""
import sys
from importlib.util import find_spec, module_from_spec
from pathlib import Path

def add(name, below, added):
    spec = find_spec(name)
    text = Path(spec.origin).read_text()
    assert text.count(below) == 1
    module = sys.modules[name] = module_from_spec(spec)
    exec(compile(text.replace(below, below + added), spec.origin, "exec"), vars(module))

add("swarmd.robot.protection.settings", {BARRIER_BELOW!r}, {BARRIER_ADDED!r})
add("swarmd.settings.robot_settings", {BELOW!r}, {ADDED!r})
"""
PLACES = """
import json
from swarmd.operator.cli.effective_config import effective_config
from swarmd.core.errors import ConfigError
from swarmd.core.goal import GoalRecord
from swarmd.daemon.robot_setup import configured_robot, recording_head
from swarmd.robot.protection.compatibility import barrier_settings
from swarmd.daemon.recording.head import head_of
from swarmd.operator.replay.replay import Replay
from swarmd.robot.latches import LatchRecord
from swarmd.robot.memory import recall, remember
from swarmd.settings.settings import load_daemon_settings
from swarmd.settings.yamlfile import text_of
from swarmd.sim.live.live_scenario import LiveScenario
from swarmd.sim.lockstep.lockstep import Lockstep
from swarmd.sim.scenarios.scenariofile import load_scenario, scenario_of

places = {}
folder = Path(sys.argv[1])

def note(place, identity):
    settings, barrier = identity.setup.settings, barrier_settings(identity.platform)
    places[place] = settings.patience, settings.fence and settings.fence.polygon, barrier.caution

def settings_of(text):
    (folder / "one.yaml").write_text(text)
    return load_daemon_settings(folder / "one.yaml", {}, {"HOME": str(folder)})

def in_daemon(place, settings):
    made = configured_robot(settings, "00", 1, latches=LatchRecord(), goals=GoalRecord())
    note(place, made.identity)
    return made

def refusal(make, *arguments):
    try:
        make(*arguments)
    except ConfigError as error:
        return str(error)

settings = settings_of("id: r1\\nplatform: ./cautious.yaml\\nswarm_file: swarm.yaml\\n")
robot = in_daemon("daemon", settings)
in_daemon("effective configuration", settings_of(effective_config(settings)))
head = head_of(recording_head(robot, "s", 0.0).texts(), "")
note("head", head.identity)
note("replay", Replay(head, {}, {})._make_robot(0.0).identity)
note("memory", recall(remember(robot), head.identity.setup).identity)
scenario = load_scenario(folder / "scenario.yaml")
note("lockstep", Lockstep(scenario, 1).shells[1].robot.identity)
note("again", Lockstep(scenario_of(scenario.effective), 1).shells[1].robot.identity)
live = LiveScenario(scenario)
live.write(folder)
config = {"id": "tb3-02", **live.daemon_config("tb3-02", folder)}
in_daemon("live", settings_of(text_of(config)))
faults = [
    refusal(settings_of, "id: r1\\npatience: 10\\n"),
    refusal(load_scenario, folder / "scenario.yaml", {"patience": 10}),
]
print(json.dumps([places, faults]))
"""


@pytest.fixture(scope="module")
def reached(tmp_path_factory: pytest.TempPathFactory) -> tuple[dict[str, object], list[str]]:
    """By place, the values of new key, fence and new setting; and the refusals of a wrong value."""
    folder = tmp_path_factory.mktemp("one")
    (folder / "swarm.yaml").write_text(KEYS)
    (folder / "cautious.yaml").write_text(PLATFORM)
    group = "groups: {tb3: {platform: cautious, count: 2, pattern: random_walk}}\n"
    group += f"platforms: {{cautious: {PLATFORM}}}\n"
    (folder / "scenario.yaml").write_text(f"{KEYS}{group}start: {{layout: grid, spacing: 1.0}}\n")
    done = subprocess.run(
        [sys.executable, "-c", WITH_FIELDS + PLACES, str(folder)],
        capture_output=True,
        text=True,
        check=False,
        cwd=ROOT,
    )
    assert done.returncode == 0, done.stderr
    places, faults = json.loads(done.stdout)
    return places, faults


@pytest.mark.integration
def test_a_key_and_a_setting_of_the_barrier_reach_each_robot_by_one_field(
    reached: tuple[dict[str, object], list[str]],
) -> None:
    places, _ = reached
    names = "daemon, effective configuration, head, replay, memory, lockstep, again, live"
    assert places == {name: [WRITTEN, SQUARE, CAUTION] for name in names.split(", ")}


@pytest.mark.integration
def test_the_bounds_of_the_field_are_those_of_both_files(
    reached: tuple[dict[str, object], list[str]],
) -> None:
    _, faults = reached
    wanted = "patience is 10; expected a number above 0 and up to 9"
    assert [fault.partition(": ")[2] for fault in faults] == [wanted, wanted]


@pytest.mark.parametrize("key", RobotSettings.__struct_fields__)
def test_each_key_is_on_its_page(key: str) -> None:
    configuration = (ROOT / "docs/configuration.md").read_text()
    assert re.search(rf"^{key}: .*#", configuration, re.MULTILINE)
