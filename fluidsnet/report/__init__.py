"""A page about training runs, made from what they logged."""
