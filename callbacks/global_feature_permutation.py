"""Permutation importance of the global feature."""

from __future__ import annotations

from typing import Any

import torch
from lightning import Callback, LightningModule, Trainer
from lightning.pytorch.utilities import rank_zero_info
from torch import Tensor
from torch.utils.data import DataLoader

from fluidsnet.model import Model
from fluidsnet.one_step import OneStepErrors
from fluidsnet.particles import Particles, Transitions
from fluidsnet.reporting.requirements import require_fluidsnet
from fluidsnet.reporting.results import results_folder
from fluidsnet.reporting.table import Cell, write_table


class GlobalFeaturePermutation(Callback):
    """Predict each frame of ``test`` once more with the global feature of another frame.

    A fixed random derangement of the frames, over all simulations and times, gives the other
    frame. It logs ``global_feature_permutation/<metric>/own`` and ``/foreign`` for `velocity_mse`
    and `skill`, and ``global_feature_permutation/ratio``, the foreign `velocity_mse` over the own
    one: 1 where the network does not use the feature, greater the more it relies on it. The same
    values are in ``global_feature_permutation.md`` and ``.csv`` in the results folder.

    It needs a global feature of one vector per frame (`GlobalVector`): others depend on the
    particles of the frame.
    """

    _metrics = ("velocity_mse", "skill")
    _header = ("global feature of", "velocity_mse m²/s²", "skill", "velocity_mse / own")

    def setup(self, trainer: Trainer, pl_module: LightningModule, stage: str) -> None:
        """Check the module, and look up the folder, all processes together."""
        require_fluidsnet(self, pl_module)
        if stage == "test":
            self._folder = results_folder(trainer)

    def on_test_start(self, trainer: Trainer, pl_module: LightningModule) -> None:
        """Reset the errors; without a vector per frame or other frames, log the reason."""
        module = require_fluidsnet(self, pl_module)
        feature = module.model.network.global_feature
        loader: Any = trainer.test_dataloaders
        reason = None
        if not feature.one_a_frame:
            reason = f"{type(feature).__name__} is not one vector per frame"
        elif not isinstance(loader, DataLoader) or loader.batch_sampler is None:
            reason = "the test split is not one data loader of batches"
        elif len(loader.dataset) < 2:  # type: ignore[arg-type]
            reason = "the test split has one frame only"
        self._errors = None
        if reason is not None:
            rank_zero_info(f"GlobalFeaturePermutation compares nothing: {reason}.")
            return
        self._loader: DataLoader[Any] = loader
        self._rows: list[list[int]] = list(loader.batch_sampler)
        self._others = _derangement(len(loader.dataset))
        self._errors = {name: OneStepErrors().to(module.device) for name in ("own", "foreign")}

    def on_test_batch_end(
        self,
        trainer: Trainer,
        pl_module: LightningModule,
        outputs: object,
        batch: Transitions,
        batch_idx: int,
        dataloader_idx: int = 0,
    ) -> None:
        """Predict a batch with the vectors of its frames, and with those of other frames."""
        if self._errors is None:
            return
        model = require_fluidsnet(self, pl_module).model
        dataset = self._loader.dataset
        others = [dataset[self._others[row]] for row in self._rows[batch_idx]]
        foreign = self._loader.collate_fn(others).state.to(pl_module.device)
        for name, source in (("own", batch.state), ("foreign", foreign)):
            vectors = _frame_vectors(model, source)
            self._errors[name].add(model.step(batch.state, vectors[batch.state.frame]), batch)

    def on_test_epoch_end(self, trainer: Trainer, pl_module: LightningModule) -> None:
        """Log the metrics and write the table."""
        if self._errors is None:
            return
        # Computed over the frames of all processes, so all of them must call it.
        values = {
            name: [float(getattr(errors, metric).compute()) for metric in self._metrics]
            for name, errors in self._errors.items()
        }
        own, foreign = values["own"], values["foreign"]
        ratio = foreign[0] / own[0] if own[0] else float("nan")
        tagged = {
            f"global_feature_permutation/{metric}/{name}": value
            for name, metrics in values.items()
            for metric, value in zip(self._metrics, metrics, strict=True)
        }
        for tag, value in {**tagged, "global_feature_permutation/ratio": ratio}.items():
            pl_module.log(tag, value, rank_zero_only=True, batch_size=1)
        if trainer.is_global_zero:
            rows: list[list[Cell]] = [
                ["the frame itself", *own, 1.0],
                ["another frame", *foreign, ratio],
            ]
            path = self._folder / "global_feature_permutation"
            print(f"{write_table(path, self._header, rows)}{path}.md")


def _derangement(frames: int) -> list[int]:
    """Return a fixed random permutation of the frames, a single cycle, so none keeps its place."""
    order = torch.randperm(frames, generator=torch.Generator().manual_seed(0))
    others = torch.empty_like(order)
    others[order] = order.roll(-1)
    return others.tolist()


def _frame_vectors(model: Model, state: Particles) -> Tensor:
    """Return the global feature of each frame, (F, width), taken from its first particle."""
    features = model.network.features(state, model.guess(state))
    particle_vectors = model.network.global_feature(state, features)
    counts = torch.bincount(state.frame, minlength=state.frames)
    # A frame without particles gets a vector that is not used.
    first = (counts.cumsum(0) - counts).clamp_max(len(state) - 1)
    vectors: Tensor = particle_vectors[first]
    return vectors
