"""Models that train side by side, drawn below the truth."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import torch
from lightning import Callback, LightningModule, Trainer
from lightning.pytorch.loggers import TensorBoardLogger
from numpy.typing import NDArray
from PIL import Image
from torch import Tensor
from tqdm import tqdm

from fluidsnet.errors import UserError
from fluidsnet.export.render import Panel, side_by_side
from fluidsnet.export.speed_colors import speed_scale
from fluidsnet.module import FluidsNet
from fluidsnet.particles import RolloutStart, RolloutStarts
from fluidsnet.reporting.run_folder import run_folder
from fluidsnet.rollout import rollout

#: Position and velocity by the number of steps, each (N, 3), m and m/s, on the CPU.
_States = dict[int, tuple[Tensor, Tensor]]


class AblationPicture(Callback):
    """In ``test``, draws the truth and a rollout of each model as ``ablation.png``.

    All roll out from the first frame of the test split's first simulation. The truth has a row,
    the model one, and each twin of an `Ablation` one; time goes to the right. Particles are
    colored by their speed, from blue at rest to white (paper, Fig. 12), on the truth's scale,
    so that a model that blows up does not turn all others dark; what is not finite is not
    drawn, and the title says so. TensorBoard has the picture as ``ablation/speed``.

    Of several only the first in the list draws. A FluidsNet without twins is drawn by itself.

    Example:
        .. code-block:: yaml

            callbacks+:
              class_path: callbacks.AblationPicture
              init_args:
                times: [0, 0.25, 0.5, 1.0]

    Args:
        times: where the columns of the picture are, as shares of the truth's length.

    Raises:
        UserError: there are no times, or one is no share.
    """

    def __init__(self, times: Sequence[float] = (0, 0.25, 0.5, 1.0)) -> None:
        if not times or not all(0 <= time <= 1 for time in times):
            raise UserError(
                f"AblationPicture: times is {list(times)}; they are shares of the truth's length, "
                "from 0 to 1, and there must be one."
            )
        self.times = times

    def setup(self, trainer: Trainer, pl_module: LightningModule, stage: str) -> None:
        """Checks who is rolled out, and learns the run's folder.

        Raises:
            UserError: the module is not a FluidsNet, or the data to test on give no rollouts.
        """
        if not isinstance(pl_module, FluidsNet):
            raise UserError("AblationPicture draws rollouts of FluidsNet alone.")
        data = getattr(trainer, "datamodule", None)
        if stage == "test" and not hasattr(data, "rollout_starts"):
            raise UserError(
                "AblationPicture needs a data module with rollout_starts, such as SPHDataModule."
            )
        callbacks: list[Callback] = trainer.callbacks  # type: ignore[attr-defined]
        self._first = next(of for of in callbacks if isinstance(of, AblationPicture)) is self
        # Asked for by all processes, since they agree on it.
        self._folder = run_folder(trainer)

    def on_test_epoch_end(self, trainer: Trainer, pl_module: LightningModule) -> None:
        """Rolls out and draws."""
        if not self._first or not trainer.is_global_zero:
            return
        assert isinstance(pl_module, FluidsNet)
        data: Any = trainer.datamodule  # type: ignore[attr-defined]
        starts: RolloutStarts = data.rollout_starts("test", [0], None, 1)
        start = starts[0]
        steps = [round(share * start.steps) for share in self.times]
        truth = {step: start.truth[step] for step in steps}
        rows = {"truth": truth, **self._roll_out(trainer, pl_module, start, steps)}
        scene = start.state.scene
        panels = [
            _panel(name, step * scene.time_step, states[step])
            for name, states in rows.items()
            for step in steps
        ]
        path = self._folder / "ablation.png"
        path.parent.mkdir(parents=True, exist_ok=True)
        side_by_side(
            path,
            panels,
            scene.domain_lower.tolist(),
            scene.domain_upper.tolist(),
            scene.particle_radius,
            speed_max=speed_scale([_speed(velocity.numpy()) for _, velocity in truth.values()]),
            columns=len(steps),
        )
        with Image.open(path) as picture:
            pixels = np.asarray(picture.convert("RGB"))
        for logger in trainer.loggers:
            if isinstance(logger, TensorBoardLogger):
                logger.experiment.add_image(
                    "ablation/speed", pixels, trainer.global_step, dataformats="HWC"
                )
        print(f"\n{path}")

    @staticmethod
    @torch.no_grad()
    def _roll_out(
        trainer: Trainer, module: FluidsNet, start: RolloutStart, steps: Sequence[int]
    ) -> dict[str, _States]:
        """Of each model, the states that are drawn."""
        start = start.to(module.device)
        models, last = module.named_models(), max(steps)
        found: dict[str, _States] = {}
        bar = tqdm(total=last * len(models), desc="drawing the ablation", unit="step", leave=False)
        for name, model in models.items():
            states = rollout(model, start.state, last)
            state, found[name] = start.state, {}
            for step in range(last + 1):
                if step > 0:
                    with trainer.precision_plugin.forward_context():
                        state = next(states)
                    bar.update()
                if step in steps:
                    found[name][step] = (state.position.cpu(), state.velocity.cpu())
        bar.close()
        return found


def _panel(name: str, time: float, state: tuple[Tensor, Tensor]) -> Panel:
    position, velocity = (value.float().numpy() for value in state)
    finite = np.isfinite(position).all(axis=1) & np.isfinite(velocity).all(axis=1)
    title = f"{name.replace('_', ' ')}, {time:.2f} s"
    if not finite.all():
        title += ", not finite"
    # Without a place, a particle is not drawn, but counted.
    return Panel(title, np.where(finite[:, None], position, np.nan), _speed(velocity))


def _speed(velocity: NDArray[Any]) -> NDArray[np.float64]:
    """(N,), in m/s, of (N, 3); twice the digits, or a square of float32 may be infinite."""
    speed: NDArray[np.float64] = np.linalg.norm(velocity.astype(np.float64), axis=1)
    return speed
