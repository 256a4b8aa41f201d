"""What went wrong on robots, and the last minute of it: `swarmctl incidents`."""
