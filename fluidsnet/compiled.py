"""Compile the torch operations of a network with torch.compile."""

from __future__ import annotations

import logging
import warnings

import torch

import fluidsnet.torch_extensions  # noqa: F401  # registers the operators named below
from fluidsnet.features.sparse_convolution import SparseConvolution
from fluidsnet.network import Network

#: Operators of torch-scatter that torch.compile cannot trace and runs as they are.
_OPAQUE = ("gather_csr", "segment_sum_csr", "segment_mean_csr")


def compile_network(network: Network) -> None:
    """Compile local feature, global feature and head, each at its first call.

    The neighbor search is not compiled, nor is a local feature that stores no edges: they are
    compiled loops or sorts already. Weights keep their names, and shapes may change between calls.

    Args:
        network: Network to change in place.
    """
    # Warnings about torch-scatter's operators and the profiler's ranges, both intended.
    warnings.filterwarnings("ignore", "(?s).*Dynamo does not know how to trace the builtin.*")
    logging.getLogger("torch._dynamo").setLevel(logging.ERROR)
    for name in _OPAQUE:
        if hasattr(torch.ops.torch_scatter, name):
            torch._dynamo.disallow_in_graph(getattr(torch.ops.torch_scatter, name))
    for module in network.modules():
        if isinstance(module, SparseConvolution):
            # Its loop over chunks of cells would be compiled again for each number of chunks.
            forward = torch.compiler.disable(module.forward)  # type: ignore[no-untyped-call]
            module.forward = forward  # type: ignore[method-assign]
    for block in (network.local, network.global_feature, network.head):
        block.compile(dynamic=True)
