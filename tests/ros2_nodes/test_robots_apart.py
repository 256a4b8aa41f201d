"""Robots of one process share no module and no chance; robots of several processes draw alike."""

from __future__ import annotations

import random
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from swarmd.core.values import Inputs
from swarmd.sim.lockstep.lockstep import simulate_run
from swarmd.sim.scenarios.scenariofile import scenario_of
from tests.sim.lockstep.test_processes import same_bits
from tests.support.ros2_nodes import launched, node_with, steps, written

DRAWS = """
import random
import numpy
from random import gauss
draws = []
def draw():
    return (random.random(), gauss(0.0, 1.0), numpy.random.rand(), numpy.random.randint(1000),
            numpy.random.default_rng().random())
draws.append(draw())
class One(Node):
    def __init__(self):
        super().__init__("one")
        self.create_timer(0.1, lambda: draws.append(draw()))
"""


def draws(robot: Any) -> list[tuple[float, ...]]:
    found: list[tuple[float, ...]] = robot.modules[0].load("one").__dict__["draws"]
    return found


def test_the_draws_of_a_robot_do_not_depend_on_other_robots(tmp_path: Path) -> None:
    alone = node_with(tmp_path, DRAWS, seed=3)
    steps(alone, [0.0, 0.1, 0.2])
    random.seed(5)
    np.random.seed(5)
    one, other = (node_with(tmp_path, DRAWS, seed=seed) for seed in (3, 4))
    for at in (0.0, 0.1, 0.2):
        random.random()
        other.step(Inputs(now=at, dt=0.1))
        one.step(Inputs(now=at, dt=0.1))
    assert draws(one) == draws(alone)
    assert len(draws(one)) == 3
    assert not {*sum(draws(one), ())} & {*sum(draws(other), ())}


def test_the_generators_of_the_process_are_left_as_they_were(tmp_path: Path) -> None:
    random.seed(5)
    np.random.seed(5)
    wanted = (random.random(), np.random.rand())
    random.seed(5)
    np.random.seed(5)
    steps(node_with(tmp_path, DRAWS), [0.0, 0.1])
    assert (random.random(), np.random.rand()) == wanted


def test_a_seed_of_no_number_is_drawn_from_the_run(tmp_path: Path) -> None:
    text = DRAWS.replace("draws = []", "draws = []\nrandom.seed()\nnumpy.random.seed()\n")
    first, second = (draws(node_with(tmp_path, text, seed=3)) for _ in range(2))
    assert first == second


UNSEEDED = """
import random
import uuid
import numpy
draws = []
class One(Node):
    def __init__(self):
        super().__init__("one")
        self.create_timer(0.1, self.draw)
    def draw(self):
        own = random.Random()
        draws.append((
            own.random(), (own.seed(), own.random())[1], numpy.random.RandomState().rand(),
            numpy.random.Generator(numpy.random.PCG64()).random(),
            numpy.random.Generator(numpy.random.Philox()).random(),
            numpy.random.SeedSequence().entropy, str(uuid.uuid4()), str(uuid.uuid1()),
        ))
"""


def test_a_generator_without_a_seed_is_seeded_from_the_run(tmp_path: Path) -> None:
    """Else two runs of one seed differ, and nobody is told."""
    found = []
    for seed in (3, 3, 4):
        robot = node_with(tmp_path, UNSEEDED, seed=seed)
        steps(robot, [0.0, 0.1, 0.2])
        found.append(draws(robot))
    first, again, other = found
    assert first == again
    assert not {*sum(first, ())} & {*sum(other, ())}
    assert len({*sum(first, ())}) == 16


def test_a_generator_with_a_seed_is_that_of_numpy(tmp_path: Path) -> None:
    text = (
        "import numpy, random\n"
        "draws = [numpy.random.RandomState(7).rand(),"
        " numpy.random.Generator(numpy.random.Philox(key=7)).random(), random.Random(7).random()]\n"
        "class One(Node):\n    def __init__(self):\n        super().__init__('one')\n"
    )
    wanted: list[object] = [
        np.random.RandomState(7).rand(),
        np.random.Generator(np.random.Philox(key=7)).random(),
        random.Random(7).random(),
    ]
    assert list(draws(node_with(tmp_path, text))) == wanted


def test_two_nodes_of_a_robot_share_no_module(tmp_path: Path) -> None:
    """On a robot each has a process of its own."""
    text = (
        "class One(Node):\n    total = 0\n    def __init__(self):\n"
        "        super().__init__('one')\n        One.total += 1\n"
        "        wanted = self.declare_parameter('wanted', '').value\n"
        "        assert (One.total, self.get_name()) == (1, wanted)\n"
    )
    (tmp_path / "one.py").write_text(f"from rclpy.node import Node\n{text}")
    entries = ", ".join(
        f"{{run: 'one:One', name: {n}, parameters: [{{wanted: {n}}}]}}" for n in "ab"
    )
    robot = launched(tmp_path, f"nodes: [{entries}]")
    assert steps(robot, [0.0])[-1].report == {"nodes": 2}


@pytest.mark.parametrize(
    ("begin", "kind"),
    [("", "'ClassVar[int]'"), ("from __future__ import annotations\n", "ClassVar[int]")],
)
def test_a_node_has_data_classes(tmp_path: Path, begin: str, kind: str) -> None:
    """They look for their module in `sys.modules`, where those of nodes are not."""
    (tmp_path / "kinds.py").write_text(
        f"{begin}from dataclasses import dataclass\nfrom typing import ClassVar\n"
        f"@dataclass\nclass Kind:\n    x: int = 0\n    count: {kind} = 3\n"
    )
    text = (
        "import sys\nfrom kinds import Kind\n"
        "class One(Node):\n    def __init__(self):\n        super().__init__('one')\n"
        "        assert repr(Kind(2)) == 'Kind(x=2)'\n"
        "        assert sys.modules['kinds'].Kind is Kind\n"
        "        assert 'kinds.no' not in sys.modules\n"
    )
    node_with(tmp_path, text)
    assert "kinds" not in sys.modules


SHARED = """
import helper
import package.inner
from package import other
from package.inner import up
counts = helper.counts
class One(Node):
    total = 0
    def __init__(self):
        super().__init__("one")
        counts.append(up())
        One.total += 1
        assert (One.total, len(counts), other.NAME, package.inner.NAME) == (
            1, 1, "package.other", "package.inner")
"""
FILES = {
    "helper.py": "counts = []\n",
    "package/__init__.py": "from .inner import up\n",
    "package/inner.py": "from . import other\nfrom .other import NAME as N\n"
    "NAME = __name__\ndef up():\n    from .other import NAME as inner\n    return inner\n",
    "package/other.py": "NAME = __name__\n",
}


def test_each_robot_imports_the_modules_anew(tmp_path: Path) -> None:
    written(tmp_path, FILES)
    before = {*sys.modules}
    first, second = (node_with(tmp_path, SHARED, robot) for robot in ("a-1", "a-2"))
    assert first.modules[0].load("helper") is not second.modules[0].load("helper")
    assert not {"helper", "package", "one", "rclpy", "geometry_msgs"} & ({*sys.modules} - before)


def test_a_folder_without_init_comes_after_installed_modules(tmp_path: Path) -> None:
    files = {"colorsys/one.py": "", "bare/inner.py": "NAME = 3\n", "bare/deep/more.py": "X = 4\n"}
    written(tmp_path, files)
    text = (
        "import colorsys\nimport bare.inner\nfrom bare.deep import more\n"
        "class One(Node):\n    def __init__(self):\n        super().__init__('one')\n"
        "        assert colorsys.rgb_to_hsv(0, 0, 0)[2] == 0\n"
        "        assert (bare.inner.NAME, more.X) == (3, 4)\n"
    )
    node_with(tmp_path, text)


def test_a_node_may_give_its_attributes_any_name(tmp_path: Path) -> None:
    """Those that this stand-in, or rclpy, has for itself are mangled."""
    names = "side _name _namespace _remap _owner _parameters _logger _publishers _subscriptions"
    names += " _timers _services _clients _resolved _message_type _result graph now log setup"
    text = (
        "class One(Node):\n    def __init__(self):\n        super().__init__('one')\n"
        f"        for name in {names.split()!r}: setattr(self, name, 'left')\n"
        "        self.declare_parameter('x', 1)\n"
        "        self.out = self.create_publisher(Twist, 'cmd_vel', 1)\n"
        "        self.create_subscription(Twist, 'a', print, 1)\n"
        "        self.create_timer(0.1, lambda: self.out.publish(Twist()))\n"
        "        self.get_logger().info(self.get_name() + self.get_namespace())\n"
    )
    assert steps(node_with(tmp_path, text), [0.0, 0.1])[-1].twist is not None


def test_a_module_that_is_missing_in_an_own_package_is_an_import_error(tmp_path: Path) -> None:
    """As in `try: from .fast import go` `except ImportError: ...`."""
    written(tmp_path, FILES)
    text = (
        "try:\n    from package.fast import go\nexcept ImportError:\n    go = None\n"
        "class One(Node):\n    def __init__(self):\n        super().__init__('one')\n"
    )
    node_with(tmp_path, text)


def test_arrays_of_one_element_are_numbers_if_the_launch_file_says_so(tmp_path: Path) -> None:
    text = (
        "import math\nimport numpy as np\n"
        "class One(Node):\n"
        "    def __init__(self):\n"
        "        super().__init__('one')\n"
        "        one = np.array([0.25])\n"
        "        assert (float(one), int(one), math.hypot(one, 0.0)) == (0.25, 0, 0.25)\n"
        "        assert isinstance(1.5, float) and not isinstance(1, float)\n"
        "        assert isinstance(np.float64(1.0), float) and float('2') == 2.0\n"
        "        assert {float: 1}[type(1.0)] == 1 and math.pi > 3\n"
        "        self.declare_parameter('x', float(one))\n"
    )
    written(tmp_path, {"one.py": f"from rclpy.node import Node\n{text}"})
    launched(tmp_path, "nodes: [{run: 'one:One'}]\none_element_arrays: true")
    with pytest.raises(Exception, match="one_element_arrays"):
        launched(tmp_path, "nodes: [{run: 'one:One'}]")


def swarm_of_seven(launch: Path) -> dict[str, Any]:
    return {
        "duration": 2.0,
        "arena": {"size": [7.0, 7.0]},
        "groups": {
            "all": {
                "platform": "burger",
                "count": 7,
                "prefix": "r",
                "pattern": "ros2_nodes",
                "parameters": {"launch": str(launch)},
            }
        },
        "start": {"layout": "random", "clearance": 0.1},
        "radio": {"loss": 0.2, "delay": 0.02},
        "plugin_dir": str(launch.parent),
    }


@pytest.mark.integration
def test_seven_robots_give_the_same_bits_in_several_processes(tmp_path: Path) -> None:
    """Each follows a wall with noise of both generators, and votes by broadcast."""
    data = swarm_of_seven(written(tmp_path) / "all.yaml")
    whole = simulate_run(scenario_of(data), 4)
    assert whole.requested is not None
    assert np.abs(whole.requested).sum() > 1.0
    assert whole.state is not None
    assert (whole.state[5:] == "running").all()
    for cores in (2, 7):
        same_bits(whole, simulate_run(scenario_of(data), 4, cores=cores))


def test_another_seed_gives_other_bits(tmp_path: Path) -> None:
    data = {**swarm_of_seven(written(tmp_path) / "all.yaml"), "duration": 1.0}
    first, again, other = (simulate_run(scenario_of(data), seed) for seed in (4, 4, 5))
    same_bits(first, again)
    assert first.pose.tobytes() != other.pose.tobytes()


def test_each_clock_of_time_is_that_of_the_robot(tmp_path: Path) -> None:
    text = """
import time
class One(Node):
    def __init__(self):
        super().__init__("one")
        assert time.clock_gettime(time.CLOCK_MONOTONIC) == time.clock_gettime_ns(1) == 0
        assert time.ctime() == time.asctime() == "Thu Jan  1 00:00:00 1970"
"""
    node_with(tmp_path, text)
