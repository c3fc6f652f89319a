"""Number of threads of the kernels."""

from __future__ import annotations

import torch
from numba import config, set_num_threads

# Below this number of particles a further thread costs more than it saves.
_PARTICLES_PER_THREAD = 4096


def max_threads() -> int:
    """Return the number of threads of kernels over many particles: at most torch's."""
    limit: int = config.NUMBA_NUM_THREADS  # type: ignore[attr-defined]
    return min(torch.get_num_threads(), limit)


def set_threads(particles: int) -> None:
    """Set the threads of the next kernels: at most torch's, fewer for few particles."""
    set_num_threads(min(max_threads(), 1 + particles // _PARTICLES_PER_THREAD))
