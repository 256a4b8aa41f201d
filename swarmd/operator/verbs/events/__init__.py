"""The verb `events`: what happened to robots, and what happens."""
