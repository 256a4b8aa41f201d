"""What a line says about a common mistake in the code of a pattern, and the place that it names."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from swarmd.core.errors import ParameterError
from swarmd.core.values import Inputs, Odometry, Pose, Scan, Twist
from swarmd.kit.behavior import MovementPattern
from swarmd.kit.mistakes import ROS_NAMES, one_line, place_of
from swarmd.kit.params import Params


class SpeedParams(Params, frozen=True):
    speed: float = 0.1


class Own(MovementPattern[SpeedParams]):
    params_type = SpeedParams

    def drive(self, inputs: Inputs) -> Twist:
        raise NotImplementedError


NO_RAYS = np.zeros(0)
SCAN = Scan(1, 0.0, NO_RAYS, NO_RAYS, 0.1, 3.5)
INPUTS = Inputs(1.0, 0.1, scan=SCAN, odometry=Odometry(0.0, Pose(), Twist()))


def line_of(folder: Path, code: str, name: str = "own.py", **beside: str) -> str:
    """The line about the exception that `code`, a line of the pattern's file, raises."""
    for module, text in beside.items():
        (folder / f"{module}.py").write_text(text)
    file = folder / name
    file.write_text(f"def drive(self, inputs):\n    {code}\n")
    pattern = object.__new__(Own)
    pattern.params = SpeedParams()
    values: dict[str, object] = {"Twist": Twist, "np": np, "__name__": "own", "__package__": ""}
    exec(compile(file.read_text(), str(file), "exec"), values)
    try:
        values["drive"](pattern, INPUTS)  # type: ignore[operator]
    except Exception as error:
        return one_line(error)
    raise AssertionError("the code raises nothing")


@pytest.mark.parametrize(
    ("code", "meant"),
    [
        ("input.scan", "`inputs.scan`"),
        ("inputs.scn", "`.scan`"),
        ("inputs.odometry.poze", "`.pose`"),
        ("self.parms", "`.params`"),
        ("self.params.sped", "`.speed`"),
        ("speed", "`self.params.speed`"),
        ("scan", "`inputs.scan`"),
        ("inputss", "`inputs`"),
        ("Twst()", "`Twist`"),
        ("np.minimun", "`.minimum`"),
    ],
)
def test_a_misspelt_name_has_the_name_that_is_meant(tmp_path: Path, code: str, meant: str) -> None:
    line = line_of(tmp_path, code)
    assert f"did you mean {meant}?" in line
    assert line.endswith("(own.py:2)")
    assert "\n" not in line


# By what a ported node writes: the name that a pattern has for it. From docs/patterns.md.
PORTED = {
    "inputs.scan.angle_min": "inputs.scan.bearings",
    "inputs.scan.angle_increment": "inputs.scan.bearings",
    "inputs.scan.header": "inputs.scan.stamp",
    "inputs.odometry.pose.position": "pose.x",
    "inputs.odometry.pose.orientation": "pose.yaw",
    "Twist().linear.x": "Twist(linear=",
    "Twist().angular.z": "Twist(linear=",
    "self.publish": "returns the Twist",
    "self.create_publisher": "returns the Twist",
    "self.get_clock": "inputs.now",
    "self.get_parameter": "self.params",
    "Twist().linear = 0.2": "Twist(linear=",
    "import rospy": "returns a Twist",
    "from geometry_msgs.msg import Twist": "returns a Twist",
}


@pytest.mark.parametrize(("code", "ours"), PORTED.items())
def test_a_name_of_ros_has_the_name_of_swarmd(tmp_path: Path, code: str, ours: str) -> None:
    line = line_of(tmp_path, code)
    assert ours in line
    assert line.endswith("(own.py:2)")


def test_a_float_that_is_set_as_a_vector_has_the_remedy(tmp_path: Path) -> None:
    assert "Twist(linear=" in line_of(tmp_path, "Twist().linear.x = 0.2")


def test_a_value_before_its_first_measurement_is_none(tmp_path: Path) -> None:
    assert "None before its first" in line_of(tmp_path, "inputs.ranges.ranges")


def test_names_of_ros_on_the_values_of_others_have_no_remedy(tmp_path: Path) -> None:
    line = line_of(tmp_path, "Path().header", "own.py")
    assert not any(text in line for text in ROS_NAMES.values())
    assert line_of(tmp_path, "(1 + 2j).header").endswith("'header' (own.py:2)")


def test_the_place_is_the_last_line_of_the_author(tmp_path: Path) -> None:
    line = line_of(tmp_path, "np.mean([[1], [2, 3]])")  # it raises within numpy
    assert line.endswith("(own.py:2)")
    assert place_of(ParameterError("never raised")) is None


# A file with a module beside it, and the folder of a pattern: what the import says.
IMPORTS = [
    ("own.py", "from .gains import TURN", ("own/pattern.py", "own/gains.py", "from .gains")),
    ("own.py", "from gains import TURN", ("own/pattern.py", "own/gains.py", "from .gains")),
    ("own.py", "import gains", ("own/pattern.py", "own/gains.py", "from .gains")),
    ("pattern.py", "from gains import TURN", ("from .gains import",)),
]


@pytest.mark.parametrize(("name", "code", "told"), IMPORTS)
def test_a_module_beside_a_pattern_has_the_next_step(
    tmp_path: Path, name: str, code: str, told: tuple[str, ...]
) -> None:
    line = line_of(tmp_path, code, name, gains="TURN = 0.4\n")
    assert all(text in line for text in told)
    assert line.endswith(f"({name}:2)")


def test_a_module_that_is_nowhere_gets_no_advice(tmp_path: Path) -> None:
    line = line_of(tmp_path, "import no_such_module_anywhere")
    assert line.endswith("'no_such_module_anywhere' (own.py:2)")
