"""Number of threads of the kernels."""

from __future__ import annotations

import torch
from numba import config, set_num_threads

# Below this number of particles a further thread costs more than it saves.
_PARTICLES_PER_THREAD = 4096


def set_threads(particles: int) -> None:
    """Set the threads of the next kernels: at most torch's, fewer for few particles."""
    limit: int = config.NUMBA_NUM_THREADS  # type: ignore[attr-defined]
    set_num_threads(min(torch.get_num_threads(), limit, 1 + particles // _PARTICLES_PER_THREAD))
