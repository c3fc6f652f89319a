"""Ablation study: test the paper's claims about the target and the global feature."""
