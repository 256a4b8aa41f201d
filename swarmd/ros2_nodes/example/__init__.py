"""The nodes that the pattern `ros2_nodes` runs without a parameter `launch`."""
