"""The network through torch.compile, but for what is compiled already."""

from __future__ import annotations

import logging
import warnings

import torch
import torch_scatter  # noqa: F401  # brings the operators named below

from fluidsnet.network import Network

#: Operators of torch-scatter, which torch.compile cannot look into: it runs them as they are.
_OPAQUE = ("gather_csr", "segment_sum_csr", "segment_mean_csr", "scatter_sum", "scatter_mean")


def compile_network(network: Network) -> None:
    """Has torch.compile make local feature, context and head, each by itself, when first called.

    The search stays as it is, and so does the local feature where no edge is stored: both are
    compiled loops or sorts. Weights keep their names, and shapes may change from call to call.

    Args:
        network: changed in place.
    """
    # Said of torch-scatter's operators and of the profiler's ranges; both are meant.
    warnings.filterwarnings("ignore", "(?s).*Dynamo does not know how to trace the builtin.*")
    logging.getLogger("torch._dynamo").setLevel(logging.ERROR)
    for name in _OPAQUE:
        if hasattr(torch.ops.torch_scatter, name):
            torch._dynamo.disallow_in_graph(getattr(torch.ops.torch_scatter, name))
    for part in (network.local, network.global_feature, network.head):
        part.compile(dynamic=True)
