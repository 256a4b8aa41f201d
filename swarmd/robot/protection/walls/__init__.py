"""Walls that stand: a layer of mode `barrier`, by which long, straight returns do not approach."""
