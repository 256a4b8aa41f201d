"""The verb `label`: gives labels to robots, and takes them away."""
