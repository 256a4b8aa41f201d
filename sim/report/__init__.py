"""Reports of experiments: one HTML file each."""
