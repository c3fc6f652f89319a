"""The network through torch.compile."""

from __future__ import annotations

from lightning import Callback, LightningModule, Trainer

from fluidsnet.compiled import compile_network
from fluidsnet.errors import UserError
from fluidsnet.module import FluidsNet


class CompiledNetwork(Callback):
    """Compiles the network's torch operations at the start of each stage.

    ``fluidsnet predict --run FOLDER --trainer.callbacks+=CompiledNetwork``. The first steps take
    a minute longer. Checkpoints are the same with and without it. It needs a C++ compiler on
    the CPU. Twins of an `Ablation` are compiled, too, if that comes before it. What
    `docs/speed.md` measured says where it pays.
    """

    def setup(self, trainer: Trainer, pl_module: LightningModule, stage: str) -> None:
        """Compiles, without changing a weight's name.

        Raises:
            UserError: the module is not a FluidsNet.
        """
        if not isinstance(pl_module, FluidsNet):
            raise UserError("CompiledNetwork compiles the network of FluidsNet alone.")
        for model in pl_module.named_models().values():
            compile_network(model.network)
