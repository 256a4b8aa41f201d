"""Evidence: long, reproducible measurements of behaviour, safety and the paper."""
