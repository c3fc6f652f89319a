"""Rollouts as VTKHDF files for ParaView."""

from __future__ import annotations

from collections.abc import Mapping

import torch
from lightning import Callback, LightningModule, Trainer

from fluidsnet.baselines import Baselines
from fluidsnet.export.vtkhdf import TrajectoryFile
from fluidsnet.metrics.positions import distance_mm, escaped
from fluidsnet.particles import Particles, RolloutStart
from fluidsnet.reporting.file_places import file_attributes, file_places
from fluidsnet.reporting.results import results_folder
from fluidsnet.rollout import RolloutObserver

# Field data with the mean distance of a predictor from the truth.
_ERRORS = {"model": "position_error_mm", **{name: f"{name}_mm" for name in Baselines.names}}


class TrajectoryWriter(Callback, RolloutObserver):
    """Write each rollout of ``predict`` to ``rollouts/<simulation>.vtkhdf``, step by step.

    The temporal VTKHDF file has `velocity` (m/s) and `position_error` (mm) at the points. Its field
    data, one number per step, are the mean distances from the truth `position_error_mm` of the
    model, `integrator_floor_mm`, `constant_velocity_mm` and `ballistic_mm`, and the share
    `escaped`; see `errors`. Distances are NaN past the truth's end. The first step is the start.
    Attributes of the file are the scene's `particle_radius` (m), `gravity` (m/s²) and `dimension`.
    """

    def setup(self, trainer: Trainer, pl_module: LightningModule, stage: str) -> None:
        """Look up the folder, all processes together."""
        if stage == "predict":
            self._folder = results_folder(trainer)

    def on_rollout_start(self, start: RolloutStart) -> None:
        """Open the file and write the first state."""
        path = self._folder / "rollouts" / f"{start.name}.vtkhdf"
        attributes = file_attributes(start.state.scene)
        self._file = TrajectoryFile(path, len(start.state), attributes)
        self._file.__enter__()
        zeros = dict.fromkeys(_ERRORS.values(), 0.0)
        outside = {"escaped": float(escaped(start.state))}
        try:
            self._append(0, start.state, start.state, zeros | outside)
        except BaseException:
            self.on_rollout_end(start)
            raise

    def on_rollout_step(
        self, start: RolloutStart, step: int, states: Mapping[str, Particles]
    ) -> None:
        """Write a state and its errors."""
        self._append(step, states["model"], states.get("truth"), errors(states))

    def on_rollout_end(self, start: RolloutStart) -> None:
        """Close the file; a rollout that an error ended keeps its steps."""
        self._file.__exit__(None, None, None)

    def _append(
        self, step: int, state: Particles, true: Particles | None, field_data: dict[str, float]
    ) -> None:
        if true is None:
            distance = torch.full_like(state.position[:, 0], torch.nan)
        else:
            distance = distance_mm(state.position, true.position, true)
        self._file.append(
            step * state.scene.time_step,
            file_places(state.position, state),
            {
                "velocity": state.velocity.cpu().numpy(),
                "position_error": distance.float().cpu().numpy(),
            },
            field_data,
        )


def errors(states: Mapping[str, Particles]) -> dict[str, float]:
    """Return the field data of a step, for the states that a `RolloutObserver` receives.

    Values that are not finite are inf; without the state of "truth" distances are NaN.
    """
    outside = escaped(states["model"])
    if "truth" not in states:
        return dict.fromkeys(_ERRORS.values(), torch.nan) | {"escaped": float(outside)}
    true = states["truth"]
    distances = [distance_mm(states[name].position, true.position, true).mean() for name in _ERRORS]
    values = torch.stack([*distances, outside])
    values = torch.nan_to_num(values, nan=torch.inf, posinf=torch.inf)
    return dict(zip((*_ERRORS.values(), "escaped"), values.tolist(), strict=True))
