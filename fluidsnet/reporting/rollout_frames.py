"""States of rollouts at a few steps, kept on the CPU, and pictures of them."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Collection, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import torch
from lightning import LightningModule, Trainer
from lightning.pytorch.loggers import TensorBoardLogger
from numpy.typing import NDArray
from PIL import Image

from fluidsnet.export.render import Panel, side_by_side
from fluidsnet.export.speed_colors import speed_scale
from fluidsnet.module import FluidsNet
from fluidsnet.particles import Particles, RolloutStart
from fluidsnet.rollout import RolloutObserver, reference_rollout, rollout
from fluidsnet.scene import Scene


class Frame(NamedTuple):
    """State of a predictor.

    Attributes:
        position: (N, 3) m.
        velocity: (N, 3) m/s.
        solid: (K, 3) of the solid particles that move, m.
    """

    position: NDArray[np.float32]
    velocity: NDArray[np.float32]
    solid: NDArray[np.float32]


#: Frames by predictor and number of steps.
Frames = dict[str, dict[int, Frame]]


@torch.no_grad()
def roll_out(
    trainer: Trainer, module: FluidsNet, start: RolloutStart
) -> Iterator[dict[str, Particles]]:
    """Yield the states of all models, the truth and the baselines after 1, 2, … steps.

    Args:
        trainer: Trainer with the precision of the models.
        module: Module with the models, in evaluation mode.
        start: Start on the module's device.
    """
    models = module.named_models()
    states = {
        name: rollout(model, start.state, start.steps, start.solids)
        for name, model in models.items()
    }
    for references in reference_rollout(start, module.model.integrator):
        with trainer.precision_plugin.forward_context():
            predicted = {name: next(model_states) for name, model_states in states.items()}
        yield {**predicted, **references}


class FirstRollout(RolloutObserver, ABC):
    """Base of callbacks that show the first rollout of `predict`.

    Attributes:
        start: Start of the first rollout; None before it.
        frames: Frames of "truth" and "model" at the steps to show; without "truth" after its end,
            and where no step of the rollout has a truth.
    """

    start: RolloutStart | None = None
    frames: Frames

    @abstractmethod
    def shown_steps(self, steps: int) -> Collection[int]:
        """Return the steps to show of a rollout of so many steps."""

    def on_predict_start(self, trainer: Trainer, pl_module: LightningModule) -> None:
        """Forget an earlier rollout."""
        self.start = None

    def on_rollout_start(self, start: RolloutStart) -> None:
        """Keep the start of the first rollout."""
        if self.start is None:
            self.start, self.frames = start, {"truth": {}, "model": {}}
            self._steps = set(self.shown_steps(start.steps))
            known = {"truth": start.state} if start.known_steps else {}
            self.on_rollout_step(start, 0, {"model": start.state, **known})

    def on_rollout_step(
        self, start: RolloutStart, step: int, states: Mapping[str, Particles]
    ) -> None:
        """Keep the states of the first rollout at the steps to show."""
        if start is self.start and step in self._steps:
            keep_frames(self.frames, step, states)


def keep_frames(frames: Frames, step: int, states: Mapping[str, Particles]) -> None:
    """Store the frame after a step, as NumPy arrays, for each predictor."""
    for name, kept in frames.items():
        if name in states:
            state = states[name]
            solid = state.solid_position[:0]
            if state.solids_move:
                solid = state.solid_position[state.solid_velocity.any(dim=1)]
            values = (state.position, state.velocity, solid)
            kept[step] = Frame(*(value.float().cpu().numpy() for value in values))


def speed_limit(frames: Frames) -> float:
    """Return the upper end of the color scale, m/s.

    It is the truth's, so that a model that blows up does not darken the other panels. Where the
    truth is known at the start only, it is that of all frames.
    """
    known = any(step > 0 for step in frames.get("truth", {}))
    shown = [frames["truth"]] if known else list(frames.values())
    return speed_scale([speed(velocity) for kept in shown for _, velocity, _ in kept.values()])


def speed(velocity: NDArray[Any]) -> NDArray[np.float64]:
    """Return the speed (N,), m/s, of velocities (N, 3), m/s."""
    # In float64: the square of a large float32 may overflow.
    result: NDArray[np.float64] = np.linalg.norm(velocity.astype(np.float64), axis=1)
    return result


def panel(name: str, time: float, frame: Frame | None) -> Panel:
    """Return the panel of a frame; particles that are not finite are left out.

    Args:
        name: Name of the predictor.
        time: Time since the start, s.
        frame: State; None for an empty panel.
    """
    title = f"{name.replace('_', ' ')}, {time:.2f} s"
    if frame is None:
        return Panel(f"no {title}", np.empty((0, 3)), np.empty(0))
    position, velocity, solid = frame
    finite = np.isfinite(np.hstack([position, velocity])).all(axis=1, keepdims=True)
    if not np.all(finite):
        title += ", not finite"
    # The renderer counts particles with a position of NaN.
    return Panel(title, np.where(finite, position, np.nan), speed(velocity), solid)


def draw_frames(
    path: Path,
    frames: Frames,
    cells: Sequence[tuple[str, int]],
    columns: int,
    scene: Scene,
    trainer: Trainer,
    tag: str,
) -> None:
    """Draw frames side by side to a PNG file and to TensorBoard, and print the path.

    Args:
        path: Path of the picture; its folder is made.
        frames: Frames by predictor and step.
        cells: Predictor and step of each panel, row after row.
        columns: Number of panels in a row.
        scene: Scene of the frames.
        trainer: Trainer with the loggers.
        tag: Tag of the picture in TensorBoard.
    """
    panels = [panel(name, step * scene.time_step, frames[name].get(step)) for name, step in cells]
    path.parent.mkdir(parents=True, exist_ok=True)
    side_by_side(
        path,
        panels,
        scene.domain_lower[0].tolist(),
        scene.domain_upper[0].tolist(),
        scene.particle_radius,
        speed_max=speed_limit(frames),
        columns=columns,
        gravity=scene.gravity[0].tolist(),
    )
    with Image.open(path) as picture:
        pixels = np.asarray(picture.convert("RGB"))
    for logger in trainer.loggers:
        if isinstance(logger, TensorBoardLogger):
            logger.experiment.add_image(tag, pixels, trainer.global_step, dataformats="HWC")
    print(path)
