"""A rollout in 3-D, to turn and to step through in TensorBoard."""

from __future__ import annotations

import numpy as np
import torch
from lightning import Callback, LightningModule, Trainer
from lightning.pytorch.loggers import TensorBoardLogger
from numpy.typing import NDArray

from callbacks.folder import rollout_file, run_folder
from fluidsnet.errors import UserError
from fluidsnet.export.speed_colors import speed_colors, speed_scale
from fluidsnet.export.vtkhdf import read_frame
from fluidsnet.particles import RolloutStart
from fluidsnet.rollout import RolloutObserver
from fluidsnet.scene import Scene

_EDGES = (109, 122, 140)  # red, green, blue of the domain's edges
_EDGE_POINTS = 60  # points along an edge

Floats = NDArray[np.float32]


class RolloutMesh(Callback, RolloutObserver):
    """After ``predict``, shows the first rollout and its truth in TensorBoard's tab "Mesh".

    Particles are points, colored by their speed from blue to white (paper, figure 12), in a box
    of grey points, the domain. `rollout_3d/truth` and `rollout_3d/prediction` have one scale of
    color, and the number of steps of the rollout as their step; the text `rollout_3d/legend`
    says what is seen. It reads the files of `TrajectoryWriter`, which must come before it.

    Args:
        times: how many states are shown, spread evenly over the truth. TensorBoard shows ten
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
        self._first: RolloutStart | None = None

    def setup(self, trainer: Trainer, pl_module: LightningModule, stage: str) -> None:
        """Learns the run's folder."""
        self._folder = run_folder(trainer)

    def on_predict_start(self, trainer: Trainer, pl_module: LightningModule) -> None:
        """Forgets earlier rollouts."""
        self._first = None

    def on_rollout_start(self, start: RolloutStart) -> None:
        """Keeps the first start."""
        self._first = self._first or start

    def on_predict_end(self, trainer: Trainer, pl_module: LightningModule) -> None:
        """Writes the states."""
        # Of several processes, the one whose rollouts have the first among them.
        if self._first is None or not trainer.is_global_zero:
            return
        loggers = [one for one in trainer.loggers if isinstance(one, TensorBoardLogger)]
        if not loggers:
            return
        start, scene = self._first, self._first.state.scene
        shown = self._drawn(len(start.state))
        last = min(start.steps, len(start.truth) - 1)
        steps = sorted(set(np.linspace(0, last, self.times).round().astype(int).tolist()))
        states: dict[tuple[str, int], tuple[Floats, Floats]] = {}
        for step in steps:
            position, velocity = (value.numpy() for value in start.truth[step])
            states["truth", step] = position[shown], velocity[shown]
            position, data = read_frame(rollout_file(self._folder, start.name), step)
            states["prediction", step] = position[shown], data["velocity"][shown]
        speeds = {key: np.linalg.norm(velocity, axis=1) for key, (_, velocity) in states.items()}
        top = speed_scale(list(speeds.values()))
        box = _edges(scene)
        lost = {"truth": 0, "prediction": 0}
        config = {"material": {"cls": "PointsMaterial", "size": 2 * scene.particle_radius}}
        for (who, step), (position, _) in states.items():
            near = _near(position, scene)
            lost[who] += int((~near).sum())
            colors = np.rint(255 * speed_colors(speeds[who, step][near], top))
            grey = np.broadcast_to(_EDGES, box.shape)
            points = torch.from_numpy(np.concatenate([position[near], box]))[None]
            paint = torch.from_numpy(np.concatenate([colors, grey]).astype(np.uint8))[None]
            for logger in loggers:
                logger.experiment.add_mesh(
                    f"rollout_3d/{who}", points, paint, config_dict=config, global_step=step
                )
        legend = (
            f"Simulation /{start.name}, states after {', '.join(map(str, steps))} steps of "
            f"{scene.time_step:g} s. {len(shown)} of {len(start.state)} particles are shown; "
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


def _near(position: Floats, scene: Scene) -> NDArray[np.bool_]:
    """Which particles are no farther from the domain than it is wide, (N,).

    The view takes in whatever there is: a single one far away would make the others a dot.
    """
    lower, upper = scene.domain_lower.cpu().numpy(), scene.domain_upper.cpu().numpy()
    width = upper - lower
    with np.errstate(invalid="ignore"):
        inside = (position >= lower - width) & (position <= upper + width)
    near: NDArray[np.bool_] = inside.all(axis=1)
    return near


def _edges(scene: Scene) -> Floats:
    """Points along the domain's twelve edges, (E, 3) m."""
    along = np.linspace(0, 1, _EDGE_POINTS)
    points = []
    for axis in range(3):
        for corner in range(4):
            edge = np.empty((_EDGE_POINTS, 3))
            edge[:, axis] = along
            edge[:, (axis + 1) % 3] = corner & 1
            edge[:, (axis + 2) % 3] = corner >> 1
            points.append(edge)
    lower, upper = scene.domain_lower.cpu().numpy(), scene.domain_upper.cpu().numpy()
    return np.asarray(lower + np.concatenate(points) * (upper - lower), np.float32)
