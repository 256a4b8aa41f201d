"""The order of the pages on the site."""

from pathlib import Path

_ROOT = Path(__file__).resolve().parents[2]


def _inside(folder: str, *pages: str) -> list[str]:
    return [f"{folder}/{page}" for page in pages]


CONTENTS = {
    "Begin": ["README", *_inside("docs", "problems", "tutorial/README", "glossary")],
    "Behaviours": ["patterns/README", *_inside("docs", "patterns", "missions", "learning")],
    "Experiments": _inside(
        "docs", "experiments", "tuning", "figures", "benchmark_suite", "paper", "from_ros2swarm"
    ),
    "Operating": _inside(
        "docs",
        "operating",
        "watching",
        "recording",
        "python",
        "zenoh",
        "agents",
        "configuration",
        "trouble",
    ),
    "Robots": [
        *_inside(
            "docs",
            "acceptance",
            "installation",
            "field",
            "security",
            "ros",
            "ros_faults",
            "drivers",
        ),
        *_inside("docs/robots", "burger", "waffle_pi", "turtlebot4", "jackal", "rosbot_xl"),
        *_inside(
            "docs/robots", "thymio", "epuck2", "crazyflie", "new_robot", "calibration", "last_word"
        ),
    ],
    "Safety and evidence": [
        "docs/safety",
        *_inside("docs/evidence", "safety", "barrier", "avoidance", "sensing", "goals"),
        *_inside("docs/evidence", "network", "security", "simulation"),
        "studies/ros/faults",
    ],
    "Reference": [
        *_inside("docs/reference", "commands", "patterns", "comparison", "platforms", "scenarios"),
        *_inside("docs/reference", "metrics", "python", "api", "testing", "experiments"),
    ],
    "Changing swarmd": [
        *("ARCHITECTURE", "CONTRIBUTING", "benchmarks/README", "CHANGELOG"),
        *("SECURITY", "CODE_OF_CONDUCT"),
    ],
}
"""The captions of the start page, with their pages."""

INNER = {
    "docs/tutorial/README": [
        *(f"docs/tutorial/{page.stem}" for page in sorted(_ROOT.glob("docs/tutorial/[0-9]-*.md"))),
        "docs/tutorial/teachers",
    ],
    "patterns/README": [
        f"patterns/{page.parent.name}/page" for page in sorted(_ROOT.glob("patterns/*/page.md"))
    ],
    "ARCHITECTURE": _inside("docs/architecture", "robot", "operator", "laboratory"),
    "CONTRIBUTING": _inside("docs/architecture", "changes", "gates"),
}
"""The pages that the contents show below another page, by that page."""
