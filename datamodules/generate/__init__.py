"""Data from the real solver: random scenes, one process a simulation."""
