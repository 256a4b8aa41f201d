"""The ROS 2 package `swarmd_bringup`; `pip install swarmd` installs what its files start."""

from pathlib import Path

from setuptools import setup

NAME = "swarmd_bringup"
SHARE = f"share/{NAME}"

setup(
    name=NAME,
    version="0.3.0",
    packages=[NAME],
    data_files=[
        ("share/ament_index/resource_index/packages", [f"resource/{NAME}"]),
        (SHARE, ["package.xml"]),
        (f"{SHARE}/launch", sorted(map(str, Path("launch").glob("*.launch.xml")))),
        (f"{SHARE}/config", ["config/robot.yaml"]),
    ],
    zip_safe=True,
    description="Launch files for robots and simulated swarms with swarmd; swarmctl for ros2 run.",
    license="Apache-2.0",
    entry_points={
        "console_scripts": [
            "swarmctl = swarmd.operator.cli.entry:swarmctl",
            "swarmd = swarmd.operator.cli.entry:swarmd",
        ]
    },
)
