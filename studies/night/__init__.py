"""Every table and figure of the pages, made by jobs from one commit: `make night`."""
