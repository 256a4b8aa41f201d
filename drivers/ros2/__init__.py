"""ROS 2 drivers over Zenoh: one driver, two key schemes (zenoh-bridge-ros2dds and rmw_zenoh)."""
