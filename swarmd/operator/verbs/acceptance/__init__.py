"""The verb `acceptance`: a person and a robot go through the steps of its acceptance test."""
