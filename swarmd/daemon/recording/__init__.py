"""Recordings of a robot: MCAP files with ROS 2 messages that Foxglove and PlotJuggler read."""
