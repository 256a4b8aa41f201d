"""Calibration: measures, by short drives, what protection assumes of a base and its lidar."""
