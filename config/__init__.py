"""Data only: platforms and scenarios as YAML."""
