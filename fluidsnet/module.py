"""FluidsNet as Lightning trains, tests and rolls it out."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial
from typing import Any, cast

import torch
from lightning import LightningModule
from lightning.pytorch.cli import OptimizerCallable
from lightning.pytorch.trainer.states import TrainerFn
from lightning.pytorch.utilities import rank_zero_info
from torch import Tensor
from torch.nn.parallel import DistributedDataParallel
from torch.optim import Optimizer
from torch.optim.lr_scheduler import LRScheduler

from fluidsnet.baselines import TRIVIAL_PREDICTORS
from fluidsnet.checkpoint import check, check_twins, describe
from fluidsnet.errors import UserError
from fluidsnet.features.local import LocalFeature
from fluidsnet.integrator import Integrator
from fluidsnet.metrics import TargetError
from fluidsnet.model import Model
from fluidsnet.neighbors import NeighborSearch
from fluidsnet.network import GlobalFeatureFactory
from fluidsnet.noise import StartNoise
from fluidsnet.one_step import OneStepErrors
from fluidsnet.optimization import adam, clip_each, total_steps
from fluidsnet.particles import Particles, RolloutStart, Transitions
from fluidsnet.rng import with_same_rng
from fluidsnet.rollout import RolloutObserver, rollout
from fluidsnet.schedule import HalfwayDrop
from fluidsnet.target import Target
from fluidsnet.walls import Walls

#: Makes a schedule from an optimizer and the number of steps of the whole run.
ScheduleCallable = Callable[[Optimizer, int], LRScheduler]


class FluidsNet(Model, LightningModule):
    """The paper's network and its training; each block can be replaced from a config.

    Args:
        grid_shape: cells of the background grid along x, y and z; follows from the data's domain
            and voxel size.
        neighbors: search for neighbors; by default the fastest where the particles are.
        local: local feature (paper, section 4.3).
        global_feature: makes the feature of the whole scene; one vector by default (sections 4.4,
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
        grid_shape: tuple[int, int, int],
        neighbors: NeighborSearch | None = None,
        local: LocalFeature | None = None,
        global_feature: GlobalFeatureFactory | None = None,
        target: Target | None = None,
        integrator: Integrator | None = None,
        walls: Walls | None = None,
        head: Sequence[int] = (32, 16, 8),
        noise: StartNoise | None = None,
        optimizer: OptimizerCallable | None = None,
        schedule: ScheduleCallable | None = None,
    ) -> None:
        super().__init__(
            grid_shape, neighbors, local, global_feature, target, integrator, walls, head, noise
        )
        self.save_hyperparameters()
        self.optimizer = optimizer or adam
        self.schedule = schedule or HalfwayDrop
        # A metric, since Lightning's mean of a number over processes is off where one of them
        # has more frames.
        self.validation_loss = TargetError()
        self.validation = torch.nn.ModuleDict({"model": OneStepErrors()})
        self.testing = torch.nn.ModuleDict(
            {name: OneStepErrors() for name in ("model", *TRIVIAL_PREDICTORS)}
        )
        self.twins = torch.nn.ModuleDict()

    def models(self) -> dict[str, Model]:
        """This one, as ``model``, and the twins that train, on the same batches, beside it."""
        return {"model": self, **cast(dict[str, Model], dict(self.twins.items()))}

    def add_twin(self, name: str, twin: Model) -> None:
        """Has a model trained, measured and saved beside this one; before Lightning's `setup`."""
        self.twins[name] = twin
        self.validation[name], self.testing[name] = OneStepErrors(), OneStepErrors()
        # Lightning's memory of which metrics there are.
        self._metric_attributes = None

    # Lightning's hooks, in the order they are called.

    def setup(self, stage: str) -> None:
        if stage == "fit":
            # A checkpoint that is resumed is read after this and has the last word.
            data: Any = self._data_module()
            for model in self.models().values():
                model.set_statistics(data.statistics, data.time_step)
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
        own = [weight for name, weight in self.named_parameters() if not name.startswith("twins.")]
        groups: list[dict[str, Any]] = [{"params": own}]
        if self.twins:
            # Named for LearningRateMonitor.
            groups[0]["name"] = "model"
            groups += [
                {"params": list(twin.parameters()), "name": name}
                for name, twin in self.twins.items()
            ]
        optimizer = self.optimizer(groups)
        scheduler = self.schedule(optimizer, total_steps(self))
        return {
            "optimizer": optimizer,
            "lr_scheduler": {
                "scheduler": scheduler,
                "interval": "step",
                "name": "train/learning_rate",  # as LearningRateMonitor logs it
            },
        }

    def configure_gradient_clipping(
        self,
        optimizer: Optimizer,
        gradient_clip_val: float | None = None,
        gradient_clip_algorithm: str | None = None,
    ) -> None:
        if self.twins and gradient_clip_val:
            clip_each(optimizer, gradient_clip_val, gradient_clip_algorithm)
        else:
            self.clip_gradients(optimizer, gradient_clip_val, gradient_clip_algorithm)

    def training_step(self, batch: Transitions, batch_index: int) -> Tensor:
        models, frames = self.models(), batch.state.frames
        losses = with_same_rng(
            self.device, [partial(model.loss, batch) for model in models.values()]
        )
        self.log("train/loss", losses[0], batch_size=frames, prog_bar=True, sync_dist=True)
        if self.twins:
            for name, loss in zip(models, losses, strict=True):
                self.log(f"ablation/train_loss/{name}", loss, batch_size=frames, sync_dist=True)
        # They share no weights, so that each gets the gradient of its own loss.
        return torch.stack(losses).sum()

    def validation_step(self, batch: Transitions, batch_index: int) -> None:
        position, velocity = batch.next_position[0], batch.next_velocity[0]
        frames = batch.state.frames
        for name, model in self.models().items():
            target, output = model.network.target, model.network(batch.state)
            motion = target.decode(output, batch.state)
            state = model.walls(model.integrator(batch.state, motion))
            errors = cast(OneStepErrors, self.validation[name])
            errors.add(state, batch)
            if model is self:
                expected = target.encode(batch.state, position, velocity)
                self.validation_loss.update(output, expected, batch.state, batch.simulation)
                self.log("val/loss", self.validation_loss, batch_size=frames)
                errors.log_from(self, "val/{}", frames)
            if self.twins:
                errors.log_from(self, f"ablation/{{}}/{name}", frames)

    def test_step(self, batch: Transitions, batch_index: int) -> None:
        guesses: dict[str, Callable[[Particles], Particles]] = {
            **self.models(),
            **TRIVIAL_PREDICTORS,
        }
        for name, predict in guesses.items():
            errors = cast(OneStepErrors, self.testing[name])
            errors.add(predict(batch.state), batch)
            errors.log_from(self, f"test/{name}/{{}}", batch.state.frames)

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
        describe(checkpoint, self.models())

    def on_load_checkpoint(self, checkpoint: dict[str, Any]) -> None:
        check(checkpoint, self)
        trainer = self._trainer
        resumed = trainer is not None and trainer.state.fn == TrainerFn.FITTING
        for name in check_twins(checkpoint, self.models(), resumed):
            rank_zero_info(f"The checkpoint's twin {name!r} is left out; the model alone is used.")

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
