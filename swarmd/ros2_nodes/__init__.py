"""Nodes of ROS 2 written in Python as a pattern: a stand-in for rclpy, without ROS."""
