"""What the ROS 2 and ROS 1 drivers share: messages, options, conversion, topics, diagnosis."""
