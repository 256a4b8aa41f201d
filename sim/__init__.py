"""The laboratory: world, lidar, real-time server, metrics."""
