"""Rollouts as files for ParaView, written as they come."""

from __future__ import annotations

import numpy as np
import torch
from lightning import Callback, LightningModule, Trainer

from fluidsnet.errors import UserError
from fluidsnet.export.vtkhdf import TrajectoryFile
from fluidsnet.metrics.position_error import distance_mm
from fluidsnet.metrics.rollout_errors import RolloutErrors
from fluidsnet.module import FluidsNet
from fluidsnet.particles import Particles, RolloutStart
from fluidsnet.reporting.run_folder import rollout_file, run_folder
from fluidsnet.rollout import RolloutObserver


class TrajectoryWriter(Callback, RolloutObserver):
    """In ``predict``, streams each rollout to ``rollouts/<simulation>.vtkhdf``.

    The file is a temporal VTKHDF file, with `velocity` (m/s) and `position_error` (mm, not a
    number past the truth's end) at the points, and for each step the figures of
    `RolloutErrors` as field data. Its first step is the start.
    """

    def setup(self, trainer: Trainer, pl_module: LightningModule, stage: str) -> None:
        """Remembers who rolls out, and where its files go.

        Raises:
            UserError: the module is not a FluidsNet.
        """
        if not isinstance(pl_module, FluidsNet):
            raise UserError("TrajectoryWriter writes rollouts of FluidsNet alone.")
        self._folder, self._module = run_folder(trainer), pl_module

    def on_rollout_start(self, start: RolloutStart) -> None:
        """Opens the file and writes the first state."""
        path = rollout_file(self._folder, start.name)
        path.parent.mkdir(parents=True, exist_ok=True)
        self._errors = RolloutErrors(start.state, self._module.model.integrator)
        self._file = TrajectoryFile(path, particles=len(start.state))
        self._file.__enter__()
        none = torch.zeros(len(start.state), device=start.state.position.device)
        self._append(0, start.state, none, torch.zeros(len(RolloutErrors.names)))

    def on_rollout_step(self, start: RolloutStart, step: int, state: Particles) -> None:
        """Writes a state, and compares it with the truth while there is one."""
        if step < len(start.truth):
            device = state.position.device
            position, velocity = (value.to(device) for value in start.truth[step])
            error = distance_mm(state.position, position)
            figures = self._errors.update(step, state, position, velocity)
        else:
            error = torch.full_like(state.position[:, 0], torch.nan)
            figures = torch.full((len(RolloutErrors.names),), torch.nan)
        self._append(step, state, error, figures)

    def on_rollout_end(self, start: RolloutStart) -> None:
        """Closes the file; what was written of a rollout that broke off is kept."""
        self._file.__exit__(None, None, None)

    def _append(
        self, step: int, state: Particles, error: torch.Tensor, figures: torch.Tensor
    ) -> None:
        self._file.append(
            step * state.scene.time_step,
            state.position.cpu().numpy(),
            {
                "velocity": state.velocity.cpu().numpy(),
                "position_error": error.cpu().numpy().astype(np.float32),
            },
            dict(zip(RolloutErrors.names, figures.tolist(), strict=True)),
        )
