"""Calibration: what protection assumes of a base and its lidar, measured by a few short drives."""
