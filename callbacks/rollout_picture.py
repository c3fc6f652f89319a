"""Truth and prediction side by side."""

from __future__ import annotations

from collections.abc import Sequence

import matplotlib.image
import numpy as np
from lightning import LightningModule, Trainer
from lightning.pytorch.loggers import TensorBoardLogger

from callbacks.first_rollout import FirstRollout
from fluidsnet.errors import UserError
from fluidsnet.export.render import Panel, side_by_side
from fluidsnet.export.speed_colors import speed_scale
from fluidsnet.export.vtkhdf import read_frame
from fluidsnet.reporting.run_folder import rollout_file


class RolloutPicture(FirstRollout):
    """After ``predict``, draws the first rollout beside its truth as ``rollout.png``.

    Particles are colored by their speed, from blue to white (paper, figure 12), on the truth's
    scale. The picture also goes to TensorBoard. It reads the files of `TrajectoryWriter`, which
    must come before it.

    Args:
        times: where the rows of the picture are, as shares of what both the rollout and the truth
            have.

    Raises:
        UserError: there are no times, or one is no share.
    """

    def __init__(self, times: Sequence[float] = (0.25, 0.5, 1.0)) -> None:
        if not times or not all(0 <= time <= 1 for time in times):
            raise UserError(
                f"RolloutPicture: times is {list(times)}; they are shares from 0 to 1, and there "
                "must be one."
            )
        self.times = times

    def on_predict_end(self, trainer: Trainer, pl_module: LightningModule) -> None:
        """Draw the picture."""
        start = self.first(trainer)
        if start is None:
            return
        scene = start.state.scene
        last = min(start.steps, len(start.truth) - 1)
        panels = []
        for step in (round(share * last) for share in self.times):
            when = f"{step * scene.time_step:.2f} s"
            true_position, true_velocity = (value.numpy() for value in start.truth[step])
            position, data = read_frame(rollout_file(self.folder, start.name), step)
            panels += [
                Panel(f"truth, {when}", true_position, _speed(true_velocity)),
                Panel(f"FluidsNet, {when}", position, _speed(data["velocity"])),
            ]
        path = self.folder / "rollout.png"
        side_by_side(
            path,
            panels,
            scene.domain_lower.tolist(),
            scene.domain_upper.tolist(),
            scene.particle_radius,
            # The first of each row is the truth's.
            speed_max=speed_scale([panel.speed for panel in panels[::2]]),
        )
        pixels = matplotlib.image.imread(path)[..., :3]
        for logger in trainer.loggers:
            if isinstance(logger, TensorBoardLogger):
                logger.experiment.add_image("rollout/side_by_side", pixels, dataformats="HWC")
        print(f"\n{path}")


def _speed(velocity: np.ndarray) -> np.ndarray:
    speed: np.ndarray = np.linalg.norm(velocity, axis=1)
    return speed
