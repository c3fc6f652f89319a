"""A progress bar over the steps of a rollout."""

from __future__ import annotations

from lightning import Callback, LightningModule, Trainer
from tqdm import tqdm

from fluidsnet.particles import Particles, RolloutStart
from fluidsnet.rollout import RolloutObserver


class RolloutProgress(Callback, RolloutObserver):
    """Shows the steps of each rollout; Lightning's own bar counts only simulations.

    Of several processes, the first alone shows its own.
    """

    def setup(self, trainer: Trainer, pl_module: LightningModule, stage: str) -> None:
        """Learns whether this process shows anything."""
        self._silent = not trainer.is_global_zero

    def on_rollout_start(self, start: RolloutStart) -> None:
        """Opens the bar."""
        self._bar = tqdm(
            total=start.steps,
            desc=f"rolling out /{start.name}",
            unit="step",
            disable=self._silent,
        )

    def on_rollout_step(self, start: RolloutStart, step: int, state: Particles) -> None:
        """Moves the bar."""
        self._bar.update()

    def on_rollout_end(self, start: RolloutStart) -> None:
        """Leaves the bar as it stands."""
        self._bar.close()
