"""The pattern that runs nodes of ROS 2: of a launch file that a parameter or the class names."""

from __future__ import annotations

import sys
from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, ClassVar

from swarmd.core.errors import ConfigError
from swarmd.core.values import Inputs, Outputs
from swarmd.kit.behavior import Context, Pattern
from swarmd.kit.params import Params, Recovery, about
from swarmd.plugins import need

EXAMPLE = Path(__file__).parent / "example" / "nodes.yaml"
"""The launch file without any other."""


class Ros2NodesParams(Params, frozen=True):
    """What runs."""

    launch: Annotated[
        str,
        about(
            "the launch file, a path on the machine that runs the pattern; empty: that of the"
            " pattern's folder, or the example",
            source="ours",
        ),
    ] = ""
    recovery: Recovery = False


class Ros2NodesPattern(Pattern[Ros2NodesParams]):
    """Runs the nodes of a launch file; see docs/ros2_nodes.md.

    A pattern in a folder of its own names its launch file, beside its `pattern.py`::

        class Follower(Ros2NodesPattern):
            launch = "nodes.yaml"
    """

    params_type = Ros2NodesParams
    needs = frozenset()
    channels: Mapping[str, type] = {"topics": list}
    launch: ClassVar[str] = ""

    def __init__(self, params: Ros2NodesParams, context: Context) -> None:
        super().__init__(params, context)
        need("rosbags", extra="ros")
        from swarmd.ros2_nodes.robot_nodes import RobotNodes  # needs rosbags, of the extra `ros`

        self._nodes = RobotNodes(self._launch_file(), context.robot, context.platform, context.rng)
        self.needs = self._nodes.needs
        if not self._nodes.launch.shared:
            self.channels = {}
        self.rate = self._nodes.launch.rate  # type: ignore[misc]  # of this launch file

    def step(self, inputs: Inputs) -> Outputs:
        """One step of all nodes."""
        return self._nodes.step(inputs)

    def update(self, params: Ros2NodesParams) -> None:
        """Apply changed parameters; ConfigError for another launch file, which takes a new run."""
        if params.launch != self.params.launch:
            raise ConfigError("launch cannot change during a run; stop, and run the pattern anew")
        super().update(params)

    def _launch_file(self) -> Path:
        if self.params.launch:
            return Path(self.params.launch).expanduser().absolute()
        if self.launch:
            file = sys.modules[type(self).__module__].__file__ or ""
            return Path(file).parent / self.launch
        return EXAMPLE
