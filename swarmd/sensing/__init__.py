"""The rays of a scan: made to mean the same from every driver, and what they show."""
