"""Solids that move as VTKHDF files for ParaView."""

from __future__ import annotations

from collections.abc import Mapping
from contextlib import ExitStack
from typing import final

import torch
from lightning import Callback, LightningModule, Trainer

from fluidsnet.export.vtkhdf import TrajectoryFile
from fluidsnet.particles import Particles, RolloutStart
from fluidsnet.reporting.file_places import file_attributes, file_places
from fluidsnet.reporting.results import results_folder
from fluidsnet.rollout import RolloutObserver


@final
class SolidWriter(Callback, RolloutObserver):
    """Write the solids that move of each rollout of ``predict``, beside its fluid.

    ``rollouts/<simulation>_solids.vtkhdf`` has the steps of ``<simulation>.vtkhdf``, and
    `velocity` (m/s) at the points. Where solids rest there is no file.
    """

    _file: TrajectoryFile | None

    def setup(self, trainer: Trainer, pl_module: LightningModule, stage: str) -> None:
        """Look up the folder, all processes together."""
        if stage == "predict":
            self._folder = results_folder(trainer)

    def on_rollout_start(self, start: RolloutStart) -> None:
        """Open the file and write the first state."""
        self._files, self._file = ExitStack(), None
        if start.solids is None or start.steps < 1:
            return
        place = start.state.solid_position
        self._moves = torch.zeros(len(place), dtype=torch.bool, device=place.device)
        # A swing may be back where it started at one of these steps, not at all of them.
        for step in {1, (start.steps + 1) // 2, start.steps}:
            self._moves |= (start.solids[step][0].to(place.device) != place).any(dim=1)
        path = self._folder / "rollouts" / f"{start.name}_solids.vtkhdf"
        attributes = file_attributes(start.state.scene)
        self._file = TrajectoryFile(path, int(self._moves.sum()), attributes)
        self._files.enter_context(self._file)
        try:
            self._append(0, start.state)
        except BaseException:
            self._files.close()
            raise

    def on_rollout_step(
        self, start: RolloutStart, step: int, states: Mapping[str, Particles]
    ) -> None:
        """Write the solids after a step."""
        self._append(step, states["model"])

    def on_rollout_end(self, start: RolloutStart) -> None:
        """Close the file."""
        self._files.close()

    def _append(self, step: int, state: Particles) -> None:
        if self._file is None:
            return
        place = file_places(state.solid_position[self._moves], state)
        velocity = state.solid_velocity[self._moves].cpu().numpy()
        self._file.append(step * state.scene.time_step, place, {"velocity": velocity})
