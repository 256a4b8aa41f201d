"""The arbiter between every wish and every motor: pure, always on, the last to decide."""
