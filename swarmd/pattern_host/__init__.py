"""Child processes that load and step patterns (pattern hosts), and the daemon's side of them.

`robot/pattern_run.py` decides on restarts after a failure, and when a requested command expires.
"""
