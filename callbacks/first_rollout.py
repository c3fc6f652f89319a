"""The rollout that is shown."""

from __future__ import annotations

from pathlib import Path

from lightning import Callback, LightningModule, Trainer

from fluidsnet.particles import RolloutStart
from fluidsnet.reporting.run_folder import run_folder
from fluidsnet.rollout import RolloutObserver


class FirstRollout(Callback, RolloutObserver):
    """Keeps the start of the first rollout of ``predict``; abstract in what becomes of it.

    Attributes:
        folder: of the run.
    """

    folder: Path
    _first: RolloutStart | None = None

    def setup(self, trainer: Trainer, pl_module: LightningModule, stage: str) -> None:
        """Learns the run's folder."""
        self.folder = run_folder(trainer)

    def on_predict_start(self, trainer: Trainer, pl_module: LightningModule) -> None:
        """Forgets earlier rollouts."""
        self._first = None

    def on_rollout_start(self, start: RolloutStart) -> None:
        """Keeps the first start."""
        self._first = self._first or start

    def first(self, trainer: Trainer) -> RolloutStart | None:
        """The first start; of several processes only in that whose rollouts have it."""
        return self._first if trainer.is_global_zero else None
