"""FluidsNet as Lightning trains, tests and rolls it out."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from typing import Any

import torch
from lightning import LightningModule
from lightning.pytorch.cli import OptimizerCallable
from torch import Tensor
from torch.nn.parallel import DistributedDataParallel
from torch.optim import Adam, Optimizer
from torch.optim.lr_scheduler import LRScheduler
from torchmetrics import MetricCollection

from fluidsnet.checkpoint import check, describe
from fluidsnet.errors import UserError
from fluidsnet.features.context import GlobalVector
from fluidsnet.features.local import LocalFeature, NeighborMean
from fluidsnet.integrator import Euler, Integrator
from fluidsnet.loss import mean_square
from fluidsnet.metrics import PositionError, Skill, TargetError, VelocityMSE
from fluidsnet.neighbors import Auto, NeighborSearch
from fluidsnet.network import ContextFactory, Network
from fluidsnet.noise import StartNoise
from fluidsnet.particles import Particles, RolloutStart, Transitions
from fluidsnet.rollout import RolloutObserver, rollout
from fluidsnet.schedule import HalfwayDrop
from fluidsnet.statistics import Statistics
from fluidsnet.target import Target, VelocityTarget
from fluidsnet.trivial import ballistic, constant_velocity
from fluidsnet.walls import OpenWalls, Walls

#: Makes a schedule from an optimizer and the number of steps of the whole run.
ScheduleCallable = Callable[[Optimizer, int], LRScheduler]

#: Who predicts: the network, and the two that know nothing of fluids.
PREDICTORS = ("model", "constant_velocity", "ballistic")


class FluidsNet(LightningModule):
    """The paper's network and its training; each block can be replaced from a config.

    Args:
        cells: of the background grid along x, y and z; follows from the data's domain and
            voxel size.
        neighbors: search for neighbors; by default the fastest where the particles are.
        local: local feature (paper, section 4.3).
        context: makes the feature of the whole scene; one vector by default (sections 4.4,
            4.5).
        target: what is predicted; the next velocity by default (section 4.2).
        integrator: from velocity to position; Euler by default (section 4.6).
        walls: what happens at the domain's border; nothing by default.
        head: widths of the layers before the last (Table 1).
        noise: on the states trained on; none by default.
        optimizer: Adam at 0.003 by default (section 5.3).
        schedule: of the learning rate; falls to 1/20 halfway by default.
    """

    def __init__(
        self,
        cells: tuple[int, int, int],
        neighbors: NeighborSearch | None = None,
        local: LocalFeature | None = None,
        context: ContextFactory | None = None,
        target: Target | None = None,
        integrator: Integrator | None = None,
        walls: Walls | None = None,
        head: Sequence[int] = (32, 16, 8),
        noise: StartNoise | None = None,
        optimizer: OptimizerCallable | None = None,
        schedule: ScheduleCallable | None = None,
    ) -> None:
        super().__init__()
        self.save_hyperparameters()
        self.network = Network(
            cells=cells,
            neighbors=neighbors or Auto(),
            local=local or NeighborMean(),
            context=context or GlobalVector,
            target=target or VelocityTarget(),
            head=head,
        )
        self.integrator = integrator or Euler()
        self.walls = walls or OpenWalls()
        self.noise = noise
        self.optimizer = optimizer or _adam
        self.schedule = schedule or HalfwayDrop
        # Part of the checkpoint, so that a network never runs at a step it was not trained on.
        self.register_buffer("time_step", torch.zeros((), dtype=torch.float64))
        self.time_step: Tensor
        if self.integrator.needs_displacement and not self.network.target.gives_displacement:
            raise UserError(
                f"The integrator {type(self.integrator).__name__} needs a target that predicts "
                f"a displacement, and {type(self.network.target).__name__} does not; use "
                "DisplacementTarget, or the integrator Euler or Trapezoid."
            )
        # A metric, since Lightning's mean of a number over processes is off where one of them
        # has more frames.
        self.validation_loss = TargetError()
        self.validation = self._metrics()
        self.testing = torch.nn.ModuleDict({name: self._metrics() for name in PREDICTORS})

    def learn_scale(self, statistics: Statistics, time_step: float) -> None:
        """Takes the scale of inputs and target, and the time step in s, from the training data."""
        self.network.set_statistics(statistics)
        if self.noise is not None:
            self.noise.set_statistics(statistics)
        self.time_step.fill_(time_step)

    def forward(self, particles: Particles) -> Particles:
        """The predicted state one step later."""
        return self.walls(self.integrator(particles, self.network.motion(particles)))

    # Lightning's hooks, in the order they are called.

    def setup(self, stage: str) -> None:
        if stage == "fit":
            # A checkpoint that is resumed is read after this and has the last word.
            data: Any = self._data_module()
            self.learn_scale(data.statistics, data.time_step)
            # All processes come to the same buffers by themselves. To send them round at each
            # call costs more than the network, and needs as many batches of each to validate.
            DistributedDataParallel._set_params_and_buffers_to_ignore_for_model(  # type: ignore[no-untyped-call]
                self, [name for name, _ in self.named_buffers()]
            )

    def on_fit_start(self) -> None:
        if self.global_rank:
            # Processes share a seed, and must not share noise, mirrors and empty cells.
            torch.manual_seed(torch.initial_seed() + self.global_rank)

    def configure_optimizers(self) -> Any:
        optimizer = self.optimizer(self.parameters())
        steps = self.trainer.estimated_stepping_batches
        if steps == float("inf"):
            raise UserError(
                "The learning rate's schedule needs to know where training ends: "
                "set trainer.max_epochs or trainer.max_steps."
            )
        scheduler = self.schedule(optimizer, int(steps))
        return {
            "optimizer": optimizer,
            "lr_scheduler": {"scheduler": scheduler, "interval": "step"},
        }

    def training_step(self, batch: Transitions, batch_index: int) -> Tensor:
        state = batch.state if self.noise is None else self.noise(batch.state)
        losses = []
        for position, velocity in zip(batch.next_position, batch.next_velocity, strict=True):
            output = self.network(state)
            expected = self.network.target.encode(state, position, velocity)
            losses.append(mean_square(output, expected))
            if len(losses) < len(batch.next_position):
                motion = self.network.target.decode(output, state)
                state = self.walls(self.integrator(state, motion))
        loss = torch.stack(losses).mean()
        frames = batch.state.frames
        self.log("train/loss", loss, batch_size=frames, prog_bar=True, sync_dist=True)
        return loss

    def validation_step(self, batch: Transitions, batch_index: int) -> None:
        position, velocity = batch.next_position[0], batch.next_velocity[0]
        output = self.network(batch.state)
        expected = self.network.target.encode(batch.state, position, velocity)
        motion = self.network.target.decode(output, batch.state)
        state = self.walls(self.integrator(batch.state, motion))
        _update(self.validation, state, batch)
        frames = batch.state.frames
        self.validation_loss.update(output, expected, batch.state, batch.simulation)
        self.log("val/loss", self.validation_loss, batch_size=frames)
        for name, metric in self.validation.items():
            shown = name == "skill"
            self.log(f"val/{name}", metric, batch_size=frames, prog_bar=shown)

    def test_step(self, batch: Transitions, batch_index: int) -> None:
        guesses = (self(batch.state), constant_velocity(batch.state), ballistic(batch.state))
        for predictor, state in zip(PREDICTORS, guesses, strict=True):
            metrics = self.testing[predictor]
            assert isinstance(metrics, MetricCollection)
            _update(metrics, state, batch)
            for name, metric in metrics.items():
                self.log(f"test/{predictor}/{name}", metric, batch_size=batch.state.frames)

    def predict_step(self, batch: RolloutStart, batch_index: int) -> None:
        callbacks = self.trainer.callbacks  # type: ignore[attr-defined]
        observers = [callback for callback in callbacks if isinstance(callback, RolloutObserver)]
        states = rollout(self.network, self.integrator, self.walls, batch.state, batch.steps)
        for observer in observers:
            observer.on_rollout_start(batch)
        try:
            for step, state in enumerate(states, start=1):
                for observer in observers:
                    observer.on_rollout_step(batch, step, state)
        finally:
            for observer in observers:
                observer.on_rollout_end(batch)

    def on_save_checkpoint(self, checkpoint: dict[str, Any]) -> None:
        describe(checkpoint, self.network)

    def on_load_checkpoint(self, checkpoint: dict[str, Any]) -> None:
        check(checkpoint, self.network)

    def on_train_start(self) -> None:
        self._check_time_step()

    def on_validation_start(self) -> None:
        self._check_time_step()

    def on_test_start(self) -> None:
        self._check_time_step()

    def on_predict_start(self) -> None:
        self._check_time_step()

    def _check_time_step(self) -> None:
        trained, found = float(self.time_step), self._data_module().time_step
        if trained == 0:
            raise UserError(
                "This network has not been trained: name a checkpoint with --ckpt_path, "
                "or a run's folder with --run."
            )
        if abs(trained - found) > 1e-6 * trained:
            raise UserError(
                f"This network was trained at a time step of {trained:g} s, and the data are "
                f"stepped by {found:g} s; set data.stride so that the two agree."
            )

    def _data_module(self) -> Any:
        data = getattr(self.trainer, "datamodule", None)
        if not hasattr(data, "time_step"):
            raise UserError(
                "FluidsNet needs a data module that knows the scene, such as SPHDataModule."
            )
        return data

    @staticmethod
    def _metrics() -> MetricCollection:
        return MetricCollection(
            {
                "velocity_mse": VelocityMSE(),
                "skill": Skill(),
                "position_error_1_mm": PositionError(),
            },
            compute_groups=False,
        )


def _adam(parameters: Iterable[Tensor]) -> Optimizer:
    return Adam(parameters, lr=0.003)


def _update(metrics: MetricCollection, state: Particles, batch: Transitions) -> None:
    """Adds a batch of predicted states to velocity_mse, skill and position error."""
    before, simulation = batch.state, batch.simulation
    position, velocity = batch.next_position[0], batch.next_velocity[0]
    metrics["velocity_mse"].update(state.velocity, velocity, before, simulation)
    metrics["skill"].update(state.velocity, velocity, before, simulation)
    metrics["position_error_1_mm"].update(state.position, position, before, simulation)
