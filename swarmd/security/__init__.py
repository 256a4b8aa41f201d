"""Identities of a swarm with their roles: rosters, certificates, and the keys of datagrams."""
