"""FluidsNet: the LightningModule that trains, tests and rolls out models."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial
from io import BytesIO
from pathlib import Path
from typing import Any, Self, cast

import torch
from lightning import LightningModule
from lightning.pytorch.cli import OptimizerCallable
from lightning.pytorch.utilities import rank_zero_info
from lightning.pytorch.utilities.exceptions import SIGTERMException
from torch import Tensor
from torch.nn.parallel import DistributedDataParallel
from torch.optim import Optimizer
from torch.optim.lr_scheduler import LRScheduler

from fluidsnet.baselines import TRIVIAL_PREDICTORS
from fluidsnet.calibration import measure_residuals
from fluidsnet.checkpoint import check, describe
from fluidsnet.checkpoint_migration import migrate
from fluidsnet.checksums import verify
from fluidsnet.errors import UserError
from fluidsnet.metrics import TargetError
from fluidsnet.model import Model
from fluidsnet.one_step import OneStepErrors
from fluidsnet.optimization import adam, clip_each, total_steps
from fluidsnet.particles import Particles, RolloutStart, Transitions
from fluidsnet.resume import SCHEDULED, check_optimizer, prepare_resume
from fluidsnet.rng import derived_seed, with_same_rng
from fluidsnet.rollout import RolloutObserver, reference_rollout, rollout
from fluidsnet.schedule import HalfwayDrop

#: Builds a learning rate schedule from an optimizer and the number of steps of the run.
ScheduleCallable = Callable[[Optimizer, int], LRScheduler]

#: Arguments of `FluidsNet` that are linked to the data module's properties of these names.
NEEDS = ("grid_shape", "dimension", "varying")

# Steps between two looks at the loss on a GPU.
_LOOK_EVERY = 50
_DIVERGED = (
    "{} is not finite at step {}, so training ends; checkpoints of earlier steps are kept. Set "
    "trainer.gradient_clip_val to 1, or lower the learning rate (model.optimizer)."
)


class FluidsNet(LightningModule):
    """Training, validation, test and prediction of a model and its twins (paper, section 5.3).

    `models` holds "model" and, by their names, twins that are trained beside it on the same
    batches; they share no weights.

    Args:
        grid_shape: Number of cells of the background grid along x, y and z; linked to the data's
            domain and voxel size.
        optimizer: Optimizer; Adam at 0.003 by default (section 5.3).
        schedule: Learning rate schedule; by default 1/20 of the rate in the second half.
        stretch_schedule: Stretch the schedule of a resumed run over the steps that it has now; by
            default it goes on as it began, and past its end the rate stays.
        warm_up: Steps that each training sample is advanced by the model before those that it
            learns from; fewer than the data's `steps`.
        dimension: Dimensions of the scenes, 2 or 3; linked to the data.
        varying: Values of the scene that vary between the training simulations; linked to the
            data.
        **blocks: Blocks of the model, see `Model`.

    Raises:
        UserError: The blocks cannot be combined, or the warm-up is negative.
    """

    def __init__(
        self,
        grid_shape: tuple[int, int, int],
        optimizer: OptimizerCallable | None = None,
        schedule: ScheduleCallable | None = None,
        stretch_schedule: bool = False,
        warm_up: int = 0,
        dimension: int = 3,
        varying: Sequence[str] = (),
        **blocks: Any,
    ) -> None:
        super().__init__()
        self.save_hyperparameters()
        # jsonargparse reads the blocks' names and types from this call.
        model = Model(grid_shape, dimension=dimension, varying=varying, **blocks)
        self.models = torch.nn.ModuleDict({"model": model})
        if warm_up < 0:
            raise UserError(f"model.warm_up is {warm_up}; set at least 0.")
        self.warm_up = warm_up
        self.optimizer = optimizer or adam
        self.schedule = schedule or HalfwayDrop
        self.stretch_schedule = stretch_schedule
        # A metric, since Lightning's mean over processes is wrong where one has more frames.
        self.validation_loss = TargetError()
        self.validation = torch.nn.ModuleDict({"model": OneStepErrors()})
        self.testing = torch.nn.ModuleDict(
            {name: OneStepErrors() for name in ("model", *TRIVIAL_PREDICTORS)}
        )
        self._resuming = False
        # Steps of the learning rate schedule; 0 until they are known.
        self._scheduled = 0

    @property
    def model(self) -> Model:
        """The model itself, without its twins."""
        return cast(Model, self.models["model"])

    def named_models(self) -> dict[str, Model]:
        """Return the model and its twins by name."""
        return cast(dict[str, Model], dict(self.models.items()))

    def add_model(self, name: str, model: Model) -> None:
        """Add a twin that is trained, measured and saved beside the model.

        Args:
            name: Name in logs and tables.
            model: Twin; added before Lightning's `setup` of the module.
        """
        self.models[name] = model
        self.validation[name], self.testing[name] = OneStepErrors(), OneStepErrors()

    def forward(self, particles: Particles) -> Particles:
        """Return the model's predicted state one time step later."""
        return self.model.step(particles)

    # Lightning's hooks, in the order they are called.

    def setup(self, stage: str) -> None:
        self._resuming, self._scheduled = stage == "fit", 0
        data: Any = self._data_module()
        for model in self.named_models().values():
            model.check_scenes(data.scenes)
        if stage == "fit":
            self.model.check_trainable()
            # A resumed checkpoint is loaded after this and overwrites these values.
            for model in self.named_models().values():
                model.set_statistics(data.statistics, data.time_step)
                if model.prior.describes:
                    model.set_residuals(measure_residuals(model.prior, data.calibration_samples()))
            # All processes compute the same buffers. Broadcasting them at each call costs more
            # than the network and needs equally many validation batches in each process.
            DistributedDataParallel._set_params_and_buffers_to_ignore_for_model(  # type: ignore[no-untyped-call]
                self, [name for name, _ in self.named_buffers()]
            )

    def on_fit_start(self) -> None:
        self._seed = torch.initial_seed()

    def on_fit_end(self) -> None:
        # A further run in this process begins with the seed of this one.
        torch.manual_seed(self._seed)

    def on_train_batch_start(self, batch: Transitions, batch_index: int) -> None:
        # Noise and empty cells of a step do not depend on what was drawn before, so that a resumed
        # run goes on as it would have; processes share a seed and must not share them.
        step = self.trainer.fit_loop.total_batch_idx
        torch.manual_seed(derived_seed(self._seed, self.global_rank, step))

    def configure_optimizers(self) -> Any:
        groups: list[dict[str, Any]] = [
            {"params": list(model.parameters()), "name": name}
            for name, model in self.models.items()
        ]
        if len(groups) == 1:
            # A name would be a part of the learning rate's tag.
            del groups[0]["name"]
        optimizer = self.optimizer(groups)
        # A resumed checkpoint has been read.
        self._scheduled = self._scheduled or total_steps(self)
        scheduler = self.schedule(optimizer, self._scheduled)
        return {
            "optimizer": optimizer,
            "lr_scheduler": {
                "scheduler": scheduler,
                "interval": "step",
                "name": "train/learning_rate",  # as LearningRateMonitor logs it
            },
        }

    def lr_scheduler_step(self, scheduler: Any, metric: Any) -> None:
        # Past its end a schedule stays where it is: a resumed cosine would climb again.
        if scheduler.last_epoch < self._scheduled:
            scheduler.step()

    def configure_gradient_clipping(
        self,
        optimizer: Optimizer,
        gradient_clip_val: float | None = None,
        gradient_clip_algorithm: str | None = None,
    ) -> None:
        if len(self.models) > 1 and gradient_clip_val:
            clip_each(optimizer, gradient_clip_val, gradient_clip_algorithm)
        else:
            self.clip_gradients(optimizer, gradient_clip_val, gradient_clip_algorithm)

    def training_step(self, batch: Transitions, batch_index: int) -> Tensor:
        models, frames = self.named_models(), batch.state.frames
        losses = with_same_rng(
            self.device, [partial(model.loss, batch, self.warm_up) for model in models.values()]
        )
        self._check_finite(losses)
        self.log("train/loss", losses[0], batch_size=frames, prog_bar=True, sync_dist=True)
        if len(models) > 1:
            for name, loss in zip(models, losses, strict=True):
                self.log(f"ablation/train_loss/{name}", loss, batch_size=frames, sync_dist=True)
        # The models share no weights: each gets the gradient of its own loss.
        return torch.stack(losses).sum()

    def validation_step(self, batch: Transitions, batch_index: int) -> None:
        position, velocity = batch.next_position[0], batch.next_velocity[0]
        frames = batch.state.frames
        for name, model in self.named_models().items():
            guess = model.guess(batch.state)
            output = model.network(batch.state, guess)
            errors = cast(OneStepErrors, self.validation[name])
            errors.add(model.advance(batch.state, guess, output), batch)
            if name == "model":
                expected = model.network.target.encode(batch.state, guess, position, velocity)
                self.validation_loss.update(output, expected, batch.state, batch.simulation)
                self.log("val/loss", self.validation_loss, batch_size=frames)
                errors.log_from(self, f"validation.{name}", "val/{}", frames)
            if len(self.models) > 1:
                errors.log_from(self, f"validation.{name}", f"ablation/{{}}/{name}", frames)

    def test_step(self, batch: Transitions, batch_index: int) -> None:
        self._check_terminated()
        predictors: dict[str, Callable[[Particles], Particles]] = {
            **{name: model.step for name, model in self.named_models().items()},
            **TRIVIAL_PREDICTORS,
        }
        for name, predict in predictors.items():
            errors = cast(OneStepErrors, self.testing[name])
            errors.add(predict(batch.state), batch)
            errors.log_from(self, f"testing.{name}", f"test/{name}/{{}}", batch.state.frames)

    def predict_step(self, batch: RolloutStart, batch_index: int) -> None:
        callbacks = self.trainer.callbacks  # type: ignore[attr-defined]
        observers = [callback for callback in callbacks if isinstance(callback, RolloutObserver)]
        states = zip(
            rollout(self.model, batch.state, batch.steps, batch.solids),
            reference_rollout(batch, self.model.integrator),
            strict=True,
        )
        started: list[RolloutObserver] = []
        try:
            for observer in observers:
                observer.on_rollout_start(batch)
                started.append(observer)
            for step, (state, references) in enumerate(states, start=1):
                self._check_terminated()
                # States are measured in full precision.
                with torch.autocast(self.device.type, enabled=False):
                    for observer in observers:
                        observer.on_rollout_step(batch, step, {"model": state, **references})
        finally:
            for observer in started:
                observer.on_rollout_end(batch)

    @classmethod
    def load_from_checkpoint(cls, checkpoint_path: Any, *args: Any, **kwargs: Any) -> Self:
        """Load a module with its weights, also from a checkpoint of an earlier version.

        Arguments are those of Lightning's method, and blocks that are not plain values.

        Raises:
            UserError: The checkpoint does not match the blocks, or is not that of its checksum.
        """
        if isinstance(checkpoint_path, str | Path) and Path(checkpoint_path).is_file():
            verify(Path(checkpoint_path))
        weights_only = kwargs.get("weights_only") is not False
        checkpoint = torch.load(checkpoint_path, map_location="cpu", weights_only=weights_only)
        migrate(checkpoint)
        file = BytesIO()
        torch.save(checkpoint, file)
        file.seek(0)
        module: Self = super().load_from_checkpoint(file, *args, **kwargs)
        return module

    def on_save_checkpoint(self, checkpoint: dict[str, Any]) -> None:
        if not all(bool(weight.isfinite().all()) for weight in self.parameters()):
            raise UserError(_DIVERGED.format("A weight", self.global_step))
        describe(checkpoint, self.named_models())
        checkpoint[SCHEDULED] = self._scheduled

    def on_load_checkpoint(self, checkpoint: dict[str, Any]) -> None:
        migrate(checkpoint)
        if self._resuming:
            check_optimizer(checkpoint, self.hparams)
            self._scheduled = prepare_resume(checkpoint, self.stretch_schedule)
        # What varies is a fact of the training data; those at hand may have no training split.
        varying = tuple(checkpoint.get("hyper_parameters", {}).get("varying", ()))
        for name, model in self.named_models().items():
            if model.varying != varying:
                self.models[name] = model.twin(varying=varying)
        for name in check(checkpoint, self.named_models(), self._resuming):
            rank_zero_info(f"The checkpoint's twin {name!r} is left out; the model alone is used.")

    def _check_terminated(self) -> None:
        """Raise Lightning's exception after SIGTERM, which it raises in training alone."""
        if self.trainer.received_sigterm:
            raise SIGTERMException

    def _check_finite(self, losses: Sequence[Tensor]) -> None:
        """Check that the losses are finite.

        Raises:
            UserError: One is not.
        """
        # On a GPU each look waits for it.
        if self.device.type == "cpu" or self.global_step % _LOOK_EVERY == 0:
            for name, loss in zip(self.models, losses, strict=True):
                if not bool(loss.isfinite()):
                    raise UserError(_DIVERGED.format(f"The loss of {name!r}", self.global_step))

    def _check_time_step(self) -> None:
        if not self.model.is_trained:
            raise UserError(
                "This network has not been trained: name a checkpoint with --ckpt_path, "
                "or a run's folder with --run."
            )
        self.model.check_time_step(self._data_module().time_step)

    on_train_start = on_validation_start = on_test_start = on_predict_start = _check_time_step

    def _data_module(self) -> Any:
        data = getattr(self.trainer, "datamodule", None)
        if not hasattr(data, "time_step"):
            raise UserError(
                "FluidsNet needs a data module that knows the scene, such as SPHDataModule."
            )
        return data
