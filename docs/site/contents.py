"""The order of the pages on the site."""

from pathlib import Path

_ROOT = Path(__file__).resolve().parents[2]


def _inside(folder: str, *pages: str) -> list[str]:
    return [f"{folder}/{page}" for page in pages]


CONTENTS = {
    "Begin": ["README", *_inside("docs", "tutorial/README", "five_robots", "glossary")],
    "Behaviours": ["patterns/README", *_inside("docs", "patterns", "missions", "learning")],
    "Experiments": _inside("docs", "experiments", "tuning", "figures", "from_ros2swarm"),
    "Operating": _inside(
        "docs",
        "operating",
        "watching",
        "recording",
        "python",
        "zenoh",
        "configuration",
        "trouble",
    ),
    "Robots": _inside(
        "docs", "acceptance", "installation", "field", "security", "robots/README", "ros"
    ),
    "Safety and evidence": _inside("docs", "safety", "evidence/README"),
    "Reference and changes": ["docs/reference/README", "CONTRIBUTING", "CHANGELOG"],
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
    "docs/experiments": _inside("docs", "writing_experiments", "cluster", "benchmark_suite"),
    "docs/from_ros2swarm": ["docs/from_argos", "docs/ros2_nodes"],
    "docs/patterns": ["docs/push"],
    "docs/trouble": ["docs/problems"],
    "docs/operating": _inside("docs", "goals", "drive", "looking_after", "simulated_swarms"),
    "docs/security": _inside("docs", "permits", "files_of_others"),
    "docs/safety": ["docs/failures", "docs/mixed_swarms", "docs/walls"],
    "docs/python": ["docs/agents", "AGENTS"],
    "docs/ros": _inside("docs", "ros_commands", "last_word"),
    "docs/robots/README": [
        *_inside("docs/robots", "burger", "waffle_pi", "turtlebot4", "jackal", "rosbot_xl"),
        *_inside("docs/robots", "thymio", "epuck2", "crazyflie", "new_robot", "calibration"),
        "docs/drivers",
    ],
    "docs/evidence/README": [
        *_inside(
            "docs/evidence", "safety", "beside", "barrier", "avoidance", "kin", "sensing", "goals"
        ),
        *_inside("docs/evidence", "assumptions", "motion"),
        *_inside("docs/evidence", "faults", "network", "security", "simulation", "mutants"),
        *("docs/paper", "docs/ros_faults", "benchmarks/README"),
        "ARCHITECTURE",
    ],
    "ARCHITECTURE": _inside("docs/architecture", "robot", "operator", "laboratory"),
    "docs/reference/README": _inside(
        "docs/reference",
        *("commands", "patterns", "platforms", "scenarios", "metrics"),
        *("api", "python", "experiments", "testing"),
    ),
    "CONTRIBUTING": [
        *_inside("docs/architecture", "changes", "gates"),
        *("SECURITY", "CODE_OF_CONDUCT"),
    ],
}
"""The pages that the contents show below another page, by that page."""
