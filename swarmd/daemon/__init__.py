"""The shell of a robot on its own machine: the loop, its beat, what it keeps on disk."""
