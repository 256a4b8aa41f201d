"""What the ROS 2 drivers share: messages, codec, conversion, options, the session and the watch."""
