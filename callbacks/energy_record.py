"""Energy and density along rollouts, which need no truth."""

from __future__ import annotations

from collections.abc import Mapping

import torch
from lightning import Callback, LightningModule, Trainer
from matplotlib.figure import Figure

from fluidsnet.errors import UserError
from fluidsnet.metrics.density import Density
from fluidsnet.metrics.energy import kinetic_energy, potential_energy
from fluidsnet.metrics.positions import escaped
from fluidsnet.particles import Particles, RolloutStart
from fluidsnet.periodic import is_periodic
from fluidsnet.reporting.results import results_folder
from fluidsnet.reporting.table import write_table
from fluidsnet.rollout import RolloutObserver
from fluidsnet.whole_file import whole_file

#: Columns of the table.
HEADER = (
    "simulation",
    "step",
    "time s",
    "kinetic J/kg",
    "potential J/kg",
    "fastest m/s",
    "density_error",
    "density_error_999",
    "escaped",
)


class EnergyRecord(Callback, RolloutObserver):
    """Write energy, density and escaped particles along each rollout of ``predict``.

    The table is ``energy.csv`` and ``.md``, the picture ``energy.png``. The potential energy is
    zero at the corner of the domain that is lowest under the scene's gravity; both energies are
    per mass. `density_error` is the mean of max(0, ρ/ρ₀ - 1), `density_error_999` its 99.9th
    percentile. A value that is not finite is inf. Of several processes, the first records its
    rollouts; the others record none.

    Args:
        rows: Greatest number of rows of a rollout, evenly spread over its steps; the start and the
            last step are among them.

    Raises:
        UserError: `rows` is below two.
    """

    def __init__(self, rows: int = 101) -> None:
        if rows < 2:
            raise UserError(f"EnergyRecord: rows is {rows}; set at least 2.")
        self.rows = rows
        self._table: list[tuple[str | float | int, ...]] = []
        self._density = Density()

    def setup(self, trainer: Trainer, pl_module: LightningModule, stage: str) -> None:
        """Look up the folder, all processes together."""
        if stage == "predict":
            self._folder = results_folder(trainer)
            self._table = []

    def on_rollout_start(self, start: RolloutStart) -> None:
        """Record the start."""
        self._every = max(1, -(-start.steps // (self.rows - 1)))
        self._add(start, 0, start.state)

    def on_rollout_step(
        self, start: RolloutStart, step: int, states: Mapping[str, Particles]
    ) -> None:
        """Record a state."""
        if step % self._every == 0 or step == start.steps:
            self._add(start, step, states["model"])

    def on_predict_end(self, trainer: Trainer, pl_module: LightningModule) -> None:
        """Write table and picture."""
        if self._table and trainer.is_global_zero:
            write_table(self._folder / "energy", HEADER, self._table)
            self._draw()

    def _add(self, start: RolloutStart, step: int, state: Particles) -> None:
        excess = (self._density(state) - 1).clamp_min(0)
        potential = potential_energy(state)
        if is_periodic(state.scene):
            # Neither the height nor the neighbors across a face are known.
            excess, potential = excess * torch.nan, potential * torch.nan
        values = torch.stack(
            [
                kinetic_energy(state),
                potential,
                state.velocity.double().norm(dim=1).max(),
                excess.mean(),
                excess.quantile(0.999),
                escaped(state),
            ]
        )
        broken = torch.nan_to_num(values, nan=torch.inf, posinf=torch.inf)
        finite = values if is_periodic(state.scene) else broken
        time = step * state.scene.time_step
        self._table.append((start.name, step, time, *finite.tolist()))

    def _draw(self) -> None:
        figure = Figure(figsize=(15, 4.2), dpi=100, layout="constrained")
        energy, density, speed = figure.subplots(1, 3)
        for name in dict.fromkeys(row[0] for row in self._table):
            rows = [row for row in self._table if row[0] == name]
            time, kinetic, potential, fastest, mean, worst = (
                [float(row[at]) for row in rows] for at in (2, 3, 4, 5, 6, 7)
            )
            total = [sum(pair) for pair in zip(kinetic, potential, strict=True)]
            (line,) = energy.plot(time, total, label=f"{name}, total")
            energy.plot(time, kinetic, "--", color=line.get_color(), label=f"{name}, kinetic")
            density.plot(time, mean, color=line.get_color(), label=f"{name}, mean")
            density.plot(time, worst, "--", color=line.get_color(), label=f"{name}, 99.9 %")
            speed.plot(time, fastest, color=line.get_color(), label=name)
        for axes, label in (
            (energy, "energy, J/kg"),
            (density, "density above that at rest"),
            (speed, "fastest particle, m/s"),
        ):
            axes.set(xlabel="time, s", ylabel=label)
            axes.grid(alpha=0.3)
            axes.legend(fontsize=8)
        with whole_file(self._folder / "energy.png") as partial:
            figure.savefig(partial)
