"""What a prediction is measured by, one step from a true state."""

from __future__ import annotations

from typing import final

from lightning import LightningModule
from torch import nn
from torchmetrics import Metric

from fluidsnet.metrics import PositionError, Skill, VelocityMSE
from fluidsnet.particles import Particles, Transitions


@final
class OneStepErrors(nn.Module):
    """`velocity_mse` (m²/s²), `skill` and `position_error_1_mm`, over the frames so far."""

    def __init__(self) -> None:
        super().__init__()
        self.velocity_mse = VelocityMSE()
        self.skill = Skill()
        self.position_error_1_mm = PositionError()

    def add(self, state: Particles, batch: Transitions) -> None:
        """Adds predicted states, whose truth is the first that follows in the batch."""
        position, velocity = batch.next_position[0], batch.next_velocity[0]
        start, simulation = batch.state, batch.simulation
        self.velocity_mse.update(state.velocity, velocity, start, simulation)
        self.skill.update(state.velocity, velocity, start, simulation)
        self.position_error_1_mm.update(state.position, position, start, simulation)

    def log_from(self, module: LightningModule, tag: str, frames: int) -> None:
        """Logs each figure; Lightning averages it over the loop and then resets it.

        Args:
            module: that this is a part of.
            tag: with ``{}`` where the figure's name goes.
            frames: of the batch just added.
        """
        for name, metric in self.named_children():
            assert isinstance(metric, Metric)
            shown = name == "skill" and tag == "val/{}"
            module.log(tag.format(name), metric, batch_size=frames, prog_bar=shown)
