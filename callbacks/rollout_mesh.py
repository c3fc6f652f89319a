"""Rollout in 3-D in TensorBoard."""

from __future__ import annotations

from collections.abc import Collection

import numpy as np
import torch
from lightning import Callback, LightningModule, Trainer
from lightning.pytorch.loggers import TensorBoardLogger

from fluidsnet.errors import UserError
from fluidsnet.export.speed_colors import speed_colors
from fluidsnet.reporting.mesh_backdrop import MeshBackdrop
from fluidsnet.reporting.rollout_frames import FirstRollout, Frame, Frames, speed, speed_limit

_SOLID = 128  # gray of solid particles that move


class RolloutMesh(FirstRollout, Callback):
    """Show the first rollout of ``predict`` and its truth in TensorBoard's tab "Mesh".

    Particles are points, colored by speed from blue to white (paper, figure 12) on the truth's
    scale, in a domain of gray points; solids that move are gray, too. The truth is on the left and
    the prediction on the right of one scene, `rollout_3d/truth_and_prediction`, so that they turn
    together; its step is that of the rollout. Past the truth's end the left domain is empty. The
    text `rollout_3d/legend` describes the scene.

    Args:
        times: Number of states shown, evenly spread over the rollout. TensorBoard keeps ten
            by default (``--samples_per_plugin meshes=100``).
        particles: Greatest number of particles shown, drawn with a fixed seed, the same in all
            states.

    Raises:
        UserError: an argument is less than 1.
    """

    def __init__(self, times: int = 9, particles: int = 5000) -> None:
        for name, value in (("times", times), ("particles", particles)):
            if value < 1:
                raise UserError(f"RolloutMesh: {name} is {value}; it must be at least 1.")
        self.times, self.particles = times, particles

    def shown_steps(self, steps: int) -> Collection[int]:
        return {round(step) for step in np.linspace(0, steps, self.times).tolist()}

    def on_predict_end(self, trainer: Trainer, pl_module: LightningModule) -> None:
        """Write the states and the legend."""
        loggers = [logger for logger in trainer.loggers if isinstance(logger, TensorBoardLogger)]
        if self.start is None or not loggers or not trainer.is_global_zero:
            return
        scene, count = self.start.state.scene, len(self.start.state)
        rows = np.sort(np.random.default_rng(0).permutation(count)[: self.particles])
        frames: Frames = {
            label: {
                step: Frame(position[rows], velocity[rows], solid)
                for step, (position, velocity, solid) in self.frames[name].items()
            }
            for label, name in (("truth", "truth"), ("prediction", "model"))
        }
        limit = speed_limit(frames)
        backdrop = MeshBackdrop(scene)
        hidden = dict.fromkeys(frames, 0)
        for step in frames["prediction"]:
            points, colors = [backdrop.points], [backdrop.colors]
            for name, shift in zip(frames, backdrop.shifts, strict=True):
                if step in frames[name]:
                    position, velocity, solid = frames[name][step]
                    near = backdrop.near(position)
                    hidden[name] += int((~near).sum())
                    points.append(position[near] + shift)
                    paint = speed_colors(speed(velocity[near]), limit)
                    colors.append(np.rint(255 * paint).astype(np.uint8))
                    points.append(solid + shift)
                    colors.append(np.full(solid.shape, _SOLID, np.uint8))
            for logger in loggers:
                logger.experiment.add_mesh(
                    "rollout_3d/truth_and_prediction",
                    torch.from_numpy(np.concatenate(points))[None],
                    torch.from_numpy(np.concatenate(colors))[None],
                    config_dict=backdrop.config,
                    global_step=step,
                )
        known = self.start.known_steps
        shown = "Truth (left) and prediction" if known else "Prediction (right), without a truth,"
        legend = (
            f"{shown} of simulation /{self.start.name} after "
            f"{', '.join(map(str, frames['prediction']))} steps of {scene.time_step:g} s. "
            f"{len(rows)} of {count} particles are shown; blue is at rest, white {limit:.2g} m/s "
            "and faster."
        )
        if 0 < known < self.start.steps:
            legend += f" The truth ends after {known} steps."
        legend += "".join(
            f" {number} times a particle of the {name} is too far away to be shown, or not finite."
            for name, number in hidden.items()
            if number
        )
        for logger in loggers:
            logger.experiment.add_text("rollout_3d/legend", legend)
        print(f"TensorBoard, tab Mesh: {legend}")
