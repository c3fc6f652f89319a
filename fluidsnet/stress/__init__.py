"""Hard cases for a model, and what became of it in them."""
