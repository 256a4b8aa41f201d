"""The verb `param`: parameters of running patterns."""
