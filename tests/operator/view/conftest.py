from tests.swarm.conftest import swarm

__all__ = ["swarm"]
