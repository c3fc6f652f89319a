"""Output of a network whose prior is free fall."""

from __future__ import annotations

from torch import Tensor

from fluidsnet.network import Network
from fluidsnet.particles import Particles
from fluidsnet.priors import FreeFall


def output_of(network: Network, particles: Particles) -> Tensor:
    """Return the output (N, width) for the fluid particles."""
    output: Tensor = network(particles, FreeFall()(particles))
    return output
