"""Errors one step ahead of a true state."""

from __future__ import annotations

from typing import final

from lightning import LightningModule
from torch import nn
from torchmetrics import Metric

from fluidsnet.metrics import PositionError, Skill, VelocityMSE
from fluidsnet.particles import Particles, Transitions


@final
class OneStepErrors(nn.Module):
    """`velocity_mse` (m²/s²), `skill` and `position_error_1_mm` over the frames added so far."""

    def __init__(self) -> None:
        super().__init__()
        self.velocity_mse = VelocityMSE()
        self.skill = Skill()
        self.position_error_1_mm = PositionError()

    def add(self, state: Particles, batch: Transitions) -> None:
        """Add predicted states, compared with the first next state of the batch."""
        position, velocity = batch.next_position[0], batch.next_velocity[0]
        start, simulation = batch.state, batch.simulation
        self.velocity_mse.update(state.velocity, velocity, start, simulation)
        self.skill.update(state.velocity, velocity, start, simulation)
        self.position_error_1_mm.update(state.position, position, start, simulation)

    def log_from(self, module: LightningModule, path: str, tag: str, frames: int) -> None:
        """Log each figure; Lightning averages it over the loop and then resets it.

        Args:
            module: Module that these errors are a part of.
            path: Attribute path of these errors in the module.
            tag: Tag with ``{}`` in place of the figure's name.
            frames: Number of frames in the batch just added.
        """
        for name, metric in self.named_children():
            assert isinstance(metric, Metric)
            # With the path Lightning does not search the module for the metric.
            module.log(
                tag.format(name),
                metric,
                batch_size=frames,
                prog_bar=tag == "val/{}" and name == "skill",
                metric_attribute=f"{path}.{name}",
            )
