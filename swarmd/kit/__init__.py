"""What patterns are made of; their authors import it from `swarmd.api`."""
