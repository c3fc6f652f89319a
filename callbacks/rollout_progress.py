"""Progress bar over the steps of a rollout."""

from __future__ import annotations

from collections.abc import Mapping

from lightning import Callback, LightningModule, Trainer

from fluidsnet.particles import Particles, RolloutStart
from fluidsnet.progress import Progress
from fluidsnet.rollout import RolloutObserver


class RolloutProgress(Callback, RolloutObserver):
    """Show the steps of each rollout; Lightning's bar counts simulations.

    Only the process of rank 0 has a bar.
    """

    def setup(self, trainer: Trainer, pl_module: LightningModule, stage: str) -> None:
        """Hide the bar in other processes than that of rank 0."""
        self._disable = not trainer.is_global_zero

    def on_rollout_start(self, start: RolloutStart) -> None:
        """Open the bar."""
        self._bar = Progress(
            total=start.steps,
            desc=f"simulation {start.name}",
            unit="step",
            leave=False,
            disable=self._disable,
        )

    def on_rollout_step(
        self, start: RolloutStart, step: int, states: Mapping[str, Particles]
    ) -> None:
        """Move the bar."""
        self._bar.update()

    def on_rollout_end(self, start: RolloutStart) -> None:
        """Close the bar."""
        self._bar.close()
