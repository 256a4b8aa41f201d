"""ROS 1 driver: an adapter process under the system Python with rospy."""
