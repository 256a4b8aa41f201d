"""Identities of a secured swarm: rosters with roles, certificates, and the keys of datagrams."""
