"""Hard cases for a model, beside its prior and the solver."""
