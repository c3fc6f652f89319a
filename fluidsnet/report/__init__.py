"""Report on training runs: an HTML page and its tables."""
