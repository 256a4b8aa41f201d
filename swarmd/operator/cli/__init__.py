"""The command lines: `swarmctl` for operators, `swarmd` for the daemon of one robot."""
