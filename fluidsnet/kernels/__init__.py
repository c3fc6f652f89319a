"""Numba kernels of the CPU and the choice between them and plain torch."""

from fluidsnet.kernels.dispatch import disabled as disabled
from fluidsnet.kernels.dispatch import use_kernel as use_kernel
