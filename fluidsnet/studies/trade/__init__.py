"""Error against cost: models, their priors, and a solver that may be careless."""
