"""Picture of rollouts of the model and its twins, below the truth."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from lightning import Callback, LightningModule, Trainer

from fluidsnet.errors import UserError
from fluidsnet.particles import RolloutStarts
from fluidsnet.progress import Progress
from fluidsnet.reporting.requirements import is_first, require_fluidsnet, require_rollout_starts
from fluidsnet.reporting.results import results_folder
from fluidsnet.reporting.rollout_frames import Frames, draw_frames, keep_frames, roll_out


class AblationPicture(Callback):
    """Draw the truth and a rollout of each model in ``test``, as ``ablation.png``.

    Rollouts start at the first frame of the test split's first simulation. The truth, the model
    and each twin of an `Ablation` have a row; time goes to the right. Particles are colored by
    speed, from blue at rest to white (paper, Fig. 12), on the truth's scale. Particles that are
    not finite are left out, and the title says so. TensorBoard has the picture as
    ``ablation/speed``.

    Of several callbacks of this class only the first draws.

    Example:
        .. code-block:: yaml

            callbacks+:
              class_path: callbacks.AblationPicture
              init_args:
                times: [0, 0.25, 0.5, 1.0]

    Args:
        times: Times of the columns, as shares of the truth's length.

    Raises:
        UserError: there are no times, or one is not between 0 and 1.
    """

    def __init__(self, times: Sequence[float] = (0, 0.25, 0.5, 1.0)) -> None:
        if not times or not all(0 <= time <= 1 for time in times):
            raise UserError(
                f"AblationPicture: times is {list(times)}; give at least one share of the truth's "
                "length, from 0 to 1."
            )
        self.times = times

    def setup(self, trainer: Trainer, pl_module: LightningModule, stage: str) -> None:
        """Check the module and the data, and look up the folder, all processes together."""
        require_fluidsnet(self, pl_module)
        if stage == "test":
            self._data = require_rollout_starts(self, trainer)
            self._folder = results_folder(trainer)

    def on_test_epoch_end(self, trainer: Trainer, pl_module: LightningModule) -> None:
        """Roll out and draw."""
        if not trainer.is_global_zero or not is_first(self, trainer):
            return
        module = require_fluidsnet(self, pl_module)
        starts: RolloutStarts = self._data.rollout_starts("test", [0], None, 1)
        start = starts[0].to(module.device)
        steps = [round(share * start.steps) for share in self.times]
        models = module.named_models()
        frames: Frames = {name: {} for name in ("truth", *models)}
        keep_frames(frames, 0, dict.fromkeys(frames, start.state))
        states = roll_out(trainer, module, replace(start, steps=max(steps)))
        bar = Progress(
            states, desc="drawing the ablation", unit="step", total=max(steps), leave=False
        )
        for step, predicted in enumerate(bar, start=1):
            if step in steps:
                keep_frames(frames, step, predicted)
        cells = [(name, step) for name in frames for step in steps]
        path = self._folder / "ablation.png"
        draw_frames(path, frames, cells, len(steps), start.state.scene, trainer, "ablation/speed")
