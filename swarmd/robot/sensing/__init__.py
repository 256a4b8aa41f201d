"""Scans: conditioning of the rays of every driver, and features of conditioned scans."""
