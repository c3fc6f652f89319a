"""A rollout in 3-D, to turn and to step through in TensorBoard."""

from __future__ import annotations

import numpy as np
import torch
from lightning import LightningModule, Trainer
from lightning.pytorch.loggers import TensorBoardLogger
from numpy.typing import NDArray

from callbacks.first_rollout import FirstRollout
from fluidsnet.errors import UserError
from fluidsnet.export.speed_colors import speed_colors, speed_scale
from fluidsnet.export.vtkhdf import read_frame
from fluidsnet.reporting.mesh_backdrop import MeshBackdrop
from fluidsnet.reporting.run_folder import rollout_file

Floats = NDArray[np.float32]


class RolloutMesh(FirstRollout):
    """After ``predict``, shows the first rollout and its truth in TensorBoard's tab "Mesh".

    Particles are points, colored by their speed from blue to white (paper, figure 12) on the
    truth's scale, in a domain of gray points. The truth is on the left and the prediction on the
    right of one scene, `rollout_3d/truth_and_prediction`, so that they turn together; its step is
    the number of the rollout's. The text `rollout_3d/legend` says what is seen. It reads the files
    of `TrajectoryWriter`, which must come before it.

    Args:
        times: how many states are shown, spread evenly over what both have. TensorBoard shows ten
            unless it is told otherwise (``--samples_per_plugin meshes=100``).
        particles: the most that are shown of a state, drawn with a fixed seed, the same in all.

    Raises:
        UserError: an argument is less than 1.
    """

    def __init__(self, times: int = 9, particles: int = 5000) -> None:
        for name, value in (("times", times), ("particles", particles)):
            if value < 1:
                raise UserError(f"RolloutMesh: {name} is {value}; it must be at least 1.")
        self.times, self.particles = times, particles

    def on_predict_end(self, trainer: Trainer, pl_module: LightningModule) -> None:
        """Writes the states."""
        start = self.first(trainer)
        if start is None:
            return
        loggers = [one for one in trainer.loggers if isinstance(one, TensorBoardLogger)]
        if not loggers:
            return
        scene = start.state.scene
        shown = self._drawn(len(start.state))
        last = min(start.steps, len(start.truth) - 1)
        steps = sorted(set(np.linspace(0, last, self.times).round().astype(int).tolist()))
        states: dict[tuple[str, int], tuple[Floats, Floats]] = {}
        for step in steps:
            position, velocity = (value.numpy() for value in start.truth[step])
            states["truth", step] = position[shown], velocity[shown]
            position, data = read_frame(rollout_file(self.folder, start.name), step)
            states["prediction", step] = position[shown], data["velocity"][shown]
        speeds = {key: np.linalg.norm(velocity, axis=1) for key, (_, velocity) in states.items()}
        top = speed_scale([speeds["truth", step] for step in steps])
        stage = MeshBackdrop(scene)
        lost = {"truth": 0, "prediction": 0}
        for step in steps:
            points, paint = [stage.points], [stage.colors]
            for who, shift in zip(lost, stage.shifts, strict=True):
                position, speed = states[who, step][0], speeds[who, step]
                near = stage.near(position)
                lost[who] += int((~near).sum())
                points.append(position[near] + shift)
                paint.append(np.rint(255 * speed_colors(speed[near], top)).astype(np.uint8))
            for logger in loggers:
                logger.experiment.add_mesh(
                    "rollout_3d/truth_and_prediction",
                    torch.from_numpy(np.concatenate(points))[None],
                    torch.from_numpy(np.concatenate(paint))[None],
                    config_dict=stage.config,
                    global_step=step,
                )
        legend = (
            f"Truth (left) and prediction of simulation /{start.name} after "
            f"{', '.join(map(str, steps))} steps of {scene.time_step:g} s. "
            f"{len(shown)} of {len(start.state)} particles are shown; "
            f"blue is at rest, white {top:.2g} m/s and faster."
        )
        legend += "".join(
            f" {count} times a particle of the {who} is too far away to be shown, or not finite."
            for who, count in lost.items()
            if count
        )
        for logger in loggers:
            logger.experiment.add_text("rollout_3d/legend", legend)
        print(f"\nTensorBoard, tab Mesh: {legend}")

    def _drawn(self, particles: int) -> NDArray[np.int64]:
        """Rows of the particles that are shown, ascending."""
        rows = np.random.default_rng(0).permutation(particles)[: self.particles]
        return np.sort(rows)
