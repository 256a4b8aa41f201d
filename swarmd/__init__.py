"""swarmd: a runtime for robot swarms."""
