"""``fluidsnet simulate``: a trained model in place of the solver."""
