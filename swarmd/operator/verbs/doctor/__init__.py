"""The verb `doctor`: findings about this machine and about robots, with what to do."""
