"""Data generator: SPlisHSPlasH on random scenes, one process per simulation."""
