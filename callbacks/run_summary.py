"""Summary of a run, printed before its first batch."""

from __future__ import annotations

from typing import Any

import torch
from lightning import Callback, LightningModule, Trainer

from fluidsnet.errors import UserError
from fluidsnet.folder_lock import FolderLock
from fluidsnet.reporting.results import results_folder
from fluidsnet.reporting.run_folder import run_folder


class RunSummary(Callback):
    """Print device, data, model, weights and the folder of the results, one line each.

    .. code-block:: text

        device   cpu, 2 threads
        data     data/demo: 1,680 training samples, 240 validation samples, time step 20 ms
        model    FluidsNet: NeighborMean, GlobalVector, VelocityTarget, Euler, OpenWalls
        weights  23,171
        results  runs/demo
    """

    def __init__(self) -> None:
        self._lock: FolderLock | None = None

    def setup(self, trainer: Trainer, pl_module: LightningModule, stage: str) -> None:
        """Look up the folder, which all processes must do together, and lock it.

        Raises:
            UserError: Another process writes to the folder, or it cannot be written.
        """
        measures = stage in ("test", "predict")
        self._folder = results_folder(trainer) if measures else run_folder(trainer)
        # A validation writes nothing but events, each process to a file of its own.
        writes = stage != "validate" and not getattr(trainer, "fast_dev_run", False)
        refused: UserError | None = None
        if writes and trainer.is_global_zero:
            try:
                self._lock = FolderLock(self._folder).__enter__()
            except UserError as error:
                refused = error
        # The other processes would wait for it.
        refused = trainer.strategy.broadcast(refused)
        if refused is not None:
            raise refused

    def teardown(self, trainer: Trainer, pl_module: LightningModule, stage: str) -> None:
        """Let other processes write to the folder."""
        if self._lock is not None:
            self._lock.close()

    def on_exception(
        self, trainer: Trainer, pl_module: LightningModule, exception: BaseException
    ) -> None:
        if self._lock is not None:
            self._lock.close()

    def on_validation_start(self, trainer: Trainer, pl_module: LightningModule) -> None:
        if trainer.state.fn == "validate":
            self.on_train_start(trainer, pl_module)

    def on_train_start(self, trainer: Trainer, pl_module: LightningModule) -> None:
        """Print the summary."""
        if not trainer.is_global_zero:
            return
        data: Any = getattr(trainer, "datamodule", None)
        loaders: dict[str, Any] = {
            "training sample": trainer.train_dataloader,
            "validation sample": trainer.val_dataloaders,
            "test sample": trainer.test_dataloaders,
            "simulation": trainer.predict_dataloaders,
        }
        counts = [_count(len(loader.dataset), unit) for unit, loader in loaders.items() if loader]
        lines = {
            "device": _device(trainer),
            "data": f"{data.root}: {', '.join(counts)}, time step {1000 * data.time_step:g} ms",
            **_model(pl_module, trainer.ckpt_path),
            "results": str(self._folder),
        }
        for name, value in lines.items():
            print(f"{name:<9}{value}", flush=True)

    on_test_start = on_predict_start = on_train_start

    def on_fit_end(self, trainer: Trainer, pl_module: LightningModule) -> None:
        """Print the checkpoint and the next command."""
        checkpoints = (self._folder / "checkpoints" / name for name in ("best.ckpt", "last.ckpt"))
        path = next((path for path in checkpoints if path.exists()), None)
        if trainer.is_global_zero and path is not None:
            print(f"{path}\nNext: fluidsnet test --run {self._folder}", flush=True)


def _count(number: int, unit: str) -> str:
    return f"{number:,} {unit}{'' if number == 1 else 's'}"


def _device(trainer: Trainer) -> str:
    device = trainer.strategy.root_device
    if device.type == "cuda":
        name = torch.cuda.get_device_name(device)
    else:
        name = _count(torch.get_num_threads(), "thread")
    processes = f", {trainer.world_size} processes" if trainer.world_size > 1 else ""
    return f"{device.type}, {name}{processes}"


def _model(module: Any, checkpoint: Any) -> dict[str, str]:
    models = dict(module.models.items())
    model = models.pop("model")
    shown = ["local", "global_feature", "target", "integrator", "walls"]
    weights = f"{sum(weight.numel() for weight in model.network.parameters()):,}"
    if model.prior.describes:
        shown.insert(0, "prior")
    if not model.network.target.width:
        shown, weights = ["prior", "target", "walls"], "none"
    blocks = ", ".join(type(model.blocks()[name]).__name__ for name in shown)
    twins = f"; together with {', '.join(models)}" if models else ""
    return {
        "model": f"{type(module).__name__}: {blocks}{twins}",
        "weights": f"{weights}{f' from {checkpoint}' if checkpoint else ''}",
    }
