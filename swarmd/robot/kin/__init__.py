"""Kin: which tracked object is which peer, by motion and mutual sight. Pure."""
