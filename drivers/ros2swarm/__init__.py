"""For users of ROS2swarm: its parameter files as parameters of the patterns of swarmd."""
