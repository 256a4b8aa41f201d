"""A vendor's message types as a package of `.msg` files: some of iRobot's Create 3."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

PACKAGE = "irobot_create_msgs"

# The fields as in iRobotEducation/irobot_create_msgs; the comments are ours.
_STATUS = "std_msgs/Header header\nbool {}\n"
_DEFINITIONS = {
    "HazardDetection": """
        # A hazard, seen by the sensor that frame_id names.
        uint8 BACKUP_LIMIT=0
        uint8 BUMP=1
        uint8 CLIFF=2
        uint8 STALL=3
        uint8 WHEEL_DROP=4
        uint8 OBJECT_PROXIMITY=5

        std_msgs/Header header
        uint8 type
    """,
    "HazardDetectionVector": """
        std_msgs/Header header
        irobot_create_msgs/HazardDetection[] detections
    """,
    "DockStatus": """
        std_msgs/Header header
        bool dock_visible
        bool is_docked  # in the dock
    """,
    "WheelStatus": """
        std_msgs/Header header
        int16 current_ma_left
        int16 current_ma_right
        int16 pwm_left
        int16 pwm_right
        bool wheels_enabled
    """,
    "KidnapStatus": _STATUS.format("is_kidnapped"),
    "SlipStatus": _STATUS.format("is_slipping"),
    "StopStatus": _STATUS.format("is_stopped"),
}


def vendor_folder(root: Path) -> Path:
    """Write the package below `root`; what to give as `message_path`."""
    return write_package(root / "share", PACKAGE, _DEFINITIONS)


def write_package(root: Path, package: str, definitions: Mapping[str, str]) -> Path:
    """Write a package with these message types below `root`, and return that."""
    folder = root / package / "msg"
    folder.mkdir(parents=True)
    for name, text in definitions.items():
        (folder / f"{name}.msg").write_text(text)
    return root


# The fields as in ros-perception/vision_msgs (ROS 2) and AprilRobotics/apriltag_msgs.
DETECTION_PACKAGES = {
    "vision_msgs": {
        "Point2D": "float64 x\nfloat64 y\n",
        "Pose2D": "vision_msgs/Point2D position\nfloat64 theta\n",
        "BoundingBox2D": "vision_msgs/Pose2D center\nfloat64 size_x\nfloat64 size_y\n",
        "BoundingBox3D": "geometry_msgs/Pose center\ngeometry_msgs/Vector3 size\n",
        "ObjectHypothesis": "string class_id\nfloat64 score\n",
        "ObjectHypothesisWithPose": (
            "vision_msgs/ObjectHypothesis hypothesis\ngeometry_msgs/PoseWithCovariance pose\n"
        ),
        **{
            f"Detection{n}D": (
                "std_msgs/Header header\nvision_msgs/ObjectHypothesisWithPose[] results\n"
                f"vision_msgs/BoundingBox{n}D bbox\nstring id\n"
            )
            for n in (2, 3)
        },
        **{
            f"Detection{n}DArray": (
                f"std_msgs/Header header\nvision_msgs/Detection{n}D[] detections\n"
            )
            for n in (2, 3)
        },
    },
    "apriltag_msgs": {
        "Point": "float64 x\nfloat64 y\n",
        "AprilTagDetection": (
            "string family\nint32 id\nint32 hamming\nfloat32 goodness\nfloat32 decision_margin\n"
            "apriltag_msgs/Point centre\napriltag_msgs/Point[4] corners\nfloat64[9] homography\n"
        ),
        "AprilTagDetectionArray": (
            "std_msgs/Header header\napriltag_msgs/AprilTagDetection[] detections\n"
        ),
    },
}


def detections_folder(root: Path) -> Path:
    """Write the packages of detections below `root`; what to give as `message_path`."""
    for package, definitions in DETECTION_PACKAGES.items():
        write_package(root / "share", package, definitions)
    return root / "share"
