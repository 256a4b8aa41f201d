"""Launch files of swarmd for ROS 2; this package has no code of its own."""
