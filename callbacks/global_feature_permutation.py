"""Whether a trained network uses its global feature at all."""

from __future__ import annotations

from typing import Any

import torch
from lightning import Callback, LightningModule, Trainer
from lightning.pytorch.utilities import rank_zero_info
from torch import Tensor
from torch.utils.data import DataLoader

from fluidsnet.errors import UserError
from fluidsnet.module import FluidsNet
from fluidsnet.network import Network
from fluidsnet.one_step import OneStepErrors
from fluidsnet.particles import Particles, Transitions
from fluidsnet.reporting.run_folder import run_folder
from fluidsnet.reporting.table import Cell, write_table


class GlobalFeaturePermutation(Callback):
    """In ``test``, also predicts each frame with the global feature of another one.

    Which one is drawn at random with a fixed seed, so that each test takes the same ones: each
    frame's feature is given to one other, of any simulation and time. It logs
    ``global_feature_permutation/<figure>/own`` and ``/foreign`` for `velocity_mse` and `skill`, and
    ``global_feature_permutation/ratio``, the foreign `velocity_mse` over its own: 1 where the
    network does not use the feature, and greater the more it relies on it. The same goes to
    ``global_feature_permutation.md`` and ``.csv`` in the run's folder.

    Only a context that is one vector a frame (`GlobalVector`) can be taken from another frame,
    whose particles are others and of another number.
    """

    _figures = ("velocity_mse", "skill")
    _header = ("global feature of", "velocity_mse m²/s²", "skill", "velocity_mse / own")

    def setup(self, trainer: Trainer, pl_module: LightningModule, stage: str) -> None:
        """Learns the run's folder.

        Raises:
            UserError: the module is not a FluidsNet.
        """
        if not isinstance(pl_module, FluidsNet):
            raise UserError(
                "GlobalFeaturePermutation looks at the global feature of FluidsNet alone."
            )
        self._folder = run_folder(trainer)

    def on_test_start(self, trainer: Trainer, pl_module: LightningModule) -> None:
        """Forgets an earlier test, and says so where there is nothing to compare."""
        assert isinstance(pl_module, FluidsNet)
        context = pl_module.model.network.global_feature
        loader: Any = trainer.test_dataloaders
        reason = None
        if not context.one_a_frame:
            reason = f"{type(context).__name__} is not one vector a frame"
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
        self._others = _others(len(loader.dataset))
        self._errors = {name: OneStepErrors().to(pl_module.device) for name in ("own", "foreign")}

    def on_test_batch_end(
        self,
        trainer: Trainer,
        pl_module: LightningModule,
        outputs: object,
        batch: Transitions,
        batch_idx: int,
        dataloader_idx: int = 0,
    ) -> None:
        """Predicts a batch once more, with either feature."""
        if self._errors is None:
            return
        assert isinstance(pl_module, FluidsNet)
        dataset = self._loader.dataset
        others = [dataset[self._others[row]] for row in self._rows[batch_idx]]
        foreign = self._loader.collate_fn(others).state.to(pl_module.device)
        for name, source in (("own", batch.state), ("foreign", foreign)):
            vectors = _vectors(pl_module.model.network, source)
            self._errors[name].add(
                pl_module.model.step(batch.state, vectors[batch.state.frame]), batch
            )

    def on_test_epoch_end(self, trainer: Trainer, pl_module: LightningModule) -> None:
        """Logs the figures and writes the table."""
        if self._errors is None:
            return
        # Over the frames of all processes; each must ask.
        found = {
            name: [float(getattr(errors, figure).compute()) for figure in self._figures]
            for name, errors in self._errors.items()
        }
        ratio = found["foreign"][0] / found["own"][0] if found["own"][0] else float("nan")
        figures = {
            f"global_feature_permutation/{figure}/{name}": value
            for name, values in found.items()
            for figure, value in zip(self._figures, values, strict=True)
        }
        for tag, value in {**figures, "global_feature_permutation/ratio": ratio}.items():
            pl_module.log(tag, value, rank_zero_only=True, batch_size=1)
        if trainer.is_global_zero:
            rows: list[list[Cell]] = [
                ["the frame itself", *found["own"], 1.0],
                ["another frame", *found["foreign"], ratio],
            ]
            path = self._folder / "global_feature_permutation"
            print(f"\n{write_table(path, self._header, rows)}\n{path}.md")


def _others(frames: int) -> list[int]:
    """For each frame another; each is the other of one: a single cycle through all."""
    order = torch.randperm(frames, generator=torch.Generator().manual_seed(0))
    others = torch.empty_like(order)
    others[order] = order.roll(-1)
    return others.tolist()


def _vectors(network: Network, state: Particles) -> Tensor:
    """The context of each frame, (F, width), which is that of any of its particles."""
    of_particles = network.global_feature(state, network.features(state))
    counts = torch.bincount(state.frame, minlength=state.frames)
    # A frame without particles gets a vector that nobody looks at.
    first = (counts.cumsum(0) - counts).clamp_max(len(state) - 1)
    vectors: Tensor = of_particles[first]
    return vectors
