"""Built-in patterns, one idea a file; registered exactly as an outsider's would be."""
