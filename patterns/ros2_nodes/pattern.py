"""Nodes of ROS 2 as a pattern: their files stay as they are, and need no ROS."""

from __future__ import annotations

from swarmd.ros2_nodes.pattern import Ros2NodesPattern


class Ros2Nodes(Ros2NodesPattern):
    """Runs the nodes of the launch file `launch`; without one, a node that keeps its distance."""

    group = "nodes"
