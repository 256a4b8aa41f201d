"""The fence: a layer that bounds commands, so that a robot stays in an area of a shared frame."""
