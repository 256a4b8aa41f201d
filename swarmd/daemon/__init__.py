"""The daemon of one robot: its loop, its timer, its files."""
