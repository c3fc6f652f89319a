"""Program that trains, measures and rolls out with one process or several (DDP).

Lightning's DDP starts the program again for each process, so it cannot be a test.
"""

from __future__ import annotations

import json
import sys
from functools import partial
from pathlib import Path
from typing import Any

import pytest
import torch
from lightning import Trainer, seed_everything
from lightning.pytorch.loggers import TensorBoardLogger
from torch import Tensor
from torch.optim import SGD
from torch.utils.data import DataLoader

from callbacks import (
    Ablation,
    GlobalFeaturePermutation,
    OneStepTable,
    RolloutMetrics,
    RolloutPicture,
    RolloutProgress,
    TrajectoryWriter,
)
from datamodules import SPHDataModule
from datamodules.order import each_once
from fluidsnet import FluidsNet
from fluidsnet.errors import UserError
from fluidsnet.features import GlobalVector
from fluidsnet.features.norm import BatchNorm
from fluidsnet.loss import mean_square
from fluidsnet.rng import preserve_rng_state
from fluidsnet.target import AccelerationTarget

#: Frames of a step, of all processes together.
BATCH = 6
STEPS = 4


class InOrder(SPHDataModule):
    """Data module with training samples in order, so that each step has the same ones."""

    def train_dataloader(self) -> DataLoader[Any]:
        return self._loader("train")


class Watched(FluidsNet):
    """FluidsNet that keeps the logged losses, the numbers of particles and a random number."""

    def on_train_start(self) -> None:
        self.losses: list[float] = []
        self.sizes: list[int] = []

    def on_train_batch_start(self, batch: Any, batch_index: int) -> None:
        super().on_train_batch_start(batch, batch_index)
        with preserve_rng_state(self.device):
            self.drawn = float(torch.rand((), device=self.device))

    def on_train_batch_end(self, outputs: Any, batch: Any, batch_idx: int) -> None:
        self.losses.append(float(self.trainer.callback_metrics["train/loss"]))
        self.sizes.append(len(batch.state))


def fit(root: Path, folder: Path, processes: int) -> None:
    """Train, test and roll out the paper's network.

    Args:
        root: Folder of the data set.
        folder: Folder for weights, metrics and files.
        processes: Number of processes that share each batch.
    """
    seed_everything(0, workers=True)
    # One frame in six: seven a simulation, so that batches mix simulations, whose particles
    # differ in number, and no split has as many frames for each of two processes.
    data = InOrder(root, 0.25, sample_every=6, batch_size=BATCH // processes, rollout_steps=2)
    model = Watched(
        data.grid_shape,
        # No random numbers in empty cells.
        global_feature=partial(GlobalVector, empty_variance=0.0),
        # Adam divides by the gradient's own size, which blows rounding up where that is tiny.
        optimizer=partial(SGD, lr=0.1),
    )
    trainer = Trainer(
        accelerator="cpu",
        devices=processes,
        strategy="ddp" if processes > 1 else "auto",
        max_steps=STEPS,
        default_root_dir=folder,
        logger=TensorBoardLogger(folder, name="run", version=""),
        log_every_n_steps=1,
        gradient_clip_val=0.5,
        num_sanity_val_steps=0,
        enable_checkpointing=False,
        enable_progress_bar=False,
        enable_model_summary=False,
        callbacks=[
            # To validate there is one simulation: one process of two has no rollout.
            OneStepTable(), RolloutMetrics(steps=2, simulations=None, every_n_validations=1),
            RolloutProgress(), TrajectoryWriter(), RolloutPicture(),
            Ablation("target", AccelerationTarget(), "acceleration"), GlobalFeaturePermutation(),
        ],
    )  # fmt: skip
    trainer.fit(model, data)
    metrics = dict(trainer.callback_metrics)
    metrics.update(trainer.test(model, data, verbose=False)[0])
    trainer.predict(model, data)
    torch.save(
        {
            "weights": model.state_dict(),
            "drawn": model.drawn,
            "losses": model.losses,
            "sizes": model.sizes,
            "shared": share(trainer.global_rank) if processes > 1 else None,
            "refusal": refusal() if processes > 1 else None,
        },
        folder / f"process_{trainer.global_rank}.pt",
    )
    if trainer.is_global_zero:
        numbers = {name: float(value) for name, value in metrics.items()}
        (folder / "metrics.json").write_text(json.dumps(numbers))


#: Rows of two processes.
SPLITS = [(5, 8), (0, 4), (2, 300), (1, 1), (1, 0), (0, 0)]


def rows_of(split: tuple[int, int]) -> tuple[Tensor, Tensor]:
    """Return rows far from zero, (N, 3), and a gradient for each."""
    random = torch.Generator().manual_seed(sum(split))
    rows = 100 + torch.randn(sum(split), 3, generator=random)
    return rows, torch.randn(rows.shape, generator=random)


def share(rank: int) -> list[tuple[Any, ...]]:
    """Return a process's share of batch norm, its gradients and statistics, and of the loss."""
    results = []
    for split in SPLITS:
        rows, gradient = (values.split(split)[rank] for values in rows_of(split))
        norm = BatchNorm(3)
        own = rows.clone().requires_grad_()
        result = norm(own)
        result.backward(gradient)
        loss = mean_square(own, gradient).detach()
        assert norm.weight.grad is not None
        results.append((result.detach(), own.grad, norm.weight.grad, norm.state_dict(), loss))
    return results


def refusal() -> str:
    """Return the error message for fewer samples than processes."""
    with pytest.raises(UserError) as error:
        each_once(range(1))
    return str(error.value)


if __name__ == "__main__":
    fit(Path(sys.argv[1]), Path(sys.argv[2]), int(sys.argv[3]))
