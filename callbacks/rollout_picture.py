"""Picture of a rollout beside its truth."""

from __future__ import annotations

from collections.abc import Collection, Sequence

from lightning import Callback, LightningModule, Trainer

from fluidsnet.errors import UserError
from fluidsnet.reporting.results import results_folder
from fluidsnet.reporting.rollout_frames import FirstRollout, draw_frames


class RolloutPicture(FirstRollout, Callback):
    """Draw the first rollout of ``predict`` beside its truth, as ``rollout.png``.

    Particles are colored by speed, from blue to white (paper, figure 12), on the truth's scale.
    Past the truth's end the truth's panel is empty; without a truth at any of the times the
    prediction is drawn alone. TensorBoard has the picture as ``rollout/side_by_side``.

    Args:
        times: Times of the rows, as shares of the rollout's length.

    Raises:
        UserError: there are no times, or one is not between 0 and 1.
    """

    def __init__(self, times: Sequence[float] = (0.25, 0.5, 1.0)) -> None:
        if not times or not all(0 <= time <= 1 for time in times):
            raise UserError(
                f"RolloutPicture: times is {list(times)}; give at least one share of the "
                "rollout's length, from 0 to 1."
            )
        self.times = times

    def setup(self, trainer: Trainer, pl_module: LightningModule, stage: str) -> None:
        """Look up the folder, all processes together."""
        if stage == "predict":
            self._folder = results_folder(trainer)

    def shown_steps(self, steps: int) -> Collection[int]:
        return [round(share * steps) for share in self.times]

    def on_predict_end(self, trainer: Trainer, pl_module: LightningModule) -> None:
        """Draw the picture."""
        if self.start is None or not trainer.is_global_zero:
            return
        titles = {"truth": "truth", "FluidsNet": "model"}
        frames = {title: self.frames[name] for title, name in titles.items() if self.frames[name]}
        cells = [(title, step) for step in self.shown_steps(self.start.steps) for title in frames]
        path, scene = self._folder / "rollout.png", self.start.state.scene
        draw_frames(path, frames, cells, len(frames), scene, trainer, "rollout/side_by_side")
