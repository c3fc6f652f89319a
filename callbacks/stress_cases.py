"""Hard cases after a test."""

from __future__ import annotations

from copy import deepcopy
from typing import Any

from lightning import Callback, LightningModule, Trainer
from lightning.pytorch.utilities import rank_zero_info

from fluidsnet.errors import UserError
from fluidsnet.module import FluidsNet
from fluidsnet.progress import Progress
from fluidsnet.reporting.results import results_folder
from fluidsnet.stress.cases import cases
from fluidsnet.stress.report import write_report
from fluidsnet.stress.runs import run_case
from fluidsnet.stress.scenes import Setting


class StressCases(Callback):
    """Roll the model out in hard cases at the end of ``test``, as ``fluidsnet stress`` does.

    The tables are ``stress.md`` and ``.csv``, the picture ``stress.png``. Particle radius, time
    step and viscosity are those of the data; the solver is not run. The first process runs them,
    on the CPU.

    Args:
        steps: Steps of each case.
        rest_steps: Steps of the cases that come to rest.

    Raises:
        UserError: A number of steps is below one.
    """

    def __init__(self, steps: int = 100, rest_steps: int = 1000) -> None:
        for name, value in (("steps", steps), ("rest_steps", rest_steps)):
            if value < 1:
                raise UserError(f"StressCases: {name} is {value}; set at least 1.")
        self.steps, self.rest_steps = steps, rest_steps

    def setup(self, trainer: Trainer, pl_module: LightningModule, stage: str) -> None:
        """Look up the folder, all processes together."""
        if stage == "test":
            if not isinstance(pl_module, FluidsNet):
                raise UserError("StressCases needs the model FluidsNet.")
            self._folder = results_folder(trainer)

    def on_test_end(self, trainer: Trainer, pl_module: LightningModule) -> None:
        """Run the cases and write the tables."""
        if not trainer.is_global_zero:
            return
        assert isinstance(pl_module, FluidsNet)
        data: Any = trainer.datamodule  # type: ignore[attr-defined]
        scene = data.scene
        if scene.dimension != 3:
            rank_zero_info("StressCases has cases of three dimensions alone.")
            return
        model = deepcopy(pl_module.model).cpu().eval()
        setting = Setting(scene.particle_radius, scene.time_step, float(scene.viscosity[0]))
        outcomes = {}
        found = cases(setting, self.steps, self.rest_steps, 0)
        with Progress(found, desc="stress", unit="case") as bar:
            for case in bar:
                outcomes[case.name] = run_case(case, model, bar.refresh)
        write_report(self._folder, [], outcomes, [])
