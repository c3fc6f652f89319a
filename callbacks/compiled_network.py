"""Networks compiled by torch.compile."""

from __future__ import annotations

from lightning import Callback, LightningModule, Trainer

from fluidsnet.compiled import compile_network
from fluidsnet.reporting.requirements import require_fluidsnet


class CompiledNetwork(Callback):
    """Compile the networks' torch operations at the start of each stage.

    ``fluidsnet predict --run FOLDER --trainer.callbacks+=CompiledNetwork``. The first steps take
    a minute longer. Checkpoints are the same with and without it. It needs a C++ compiler on
    the CPU. Twins of an `Ablation` that comes before it are compiled too. `docs/speed.md` has the
    speedups measured.
    """

    def setup(self, trainer: Trainer, pl_module: LightningModule, stage: str) -> None:
        """Compile the networks; names of weights stay the same."""
        for model in require_fluidsnet(self, pl_module).named_models().values():
            compile_network(model.network)
