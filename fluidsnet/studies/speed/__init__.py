"""Speed study: time of a network step against the number of particles, and the solver's time."""
