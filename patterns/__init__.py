"""Built-in patterns, one per file; they register in the same way as installed plugins."""
