"""How many threads compiled loops take."""

from __future__ import annotations

import torch
from numba import config, set_num_threads

# Particles that are worth a thread: for fewer, threads wait for each other longer.
_A_THREAD = 4096


def take_threads(particles: int) -> None:
    """Lets numba's next loops over so many particles have at most as many threads as torch."""
    most: int = config.NUMBA_NUM_THREADS  # type: ignore[attr-defined]
    set_num_threads(min(torch.get_num_threads(), most, 1 + particles // _A_THREAD))
