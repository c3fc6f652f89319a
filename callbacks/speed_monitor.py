"""How fast training goes, and where its time goes."""

from __future__ import annotations

import time
from copy import deepcopy

import torch
from lightning import Callback, LightningModule, Trainer

from fluidsnet.errors import UserError
from fluidsnet.memory import peak_bytes
from fluidsnet.module import FluidsNet
from fluidsnet.particles import Transitions


class SpeedMonitor(Callback):
    """Logs under ``speed/``, for each interval of ``trainer.log_every_n_steps`` steps of training.

    ===========================  ==================================================================
    `steps_per_second`           steps of the optimizer, reading the data included; validations,
                                 the first step, which compiles, and this callback's own search
                                 are left out
    `particles_per_second`       fluid particles stepped, one that is stepped twice counts twice
    `step_seconds`               1 / `steps_per_second`
    `data_seconds`               of it: until the next batch is there
    `search_seconds`             of it: the searches for neighbors, as many as a step has, each as
                                 long as one that is timed by itself at the interval's end
    `network_seconds`            of it: the rest, so forward and backward pass, and the optimizer
    `peak_memory_mb`             the most memory so far, 10⁶ bytes: what torch gave out on CUDA, the
                                 process's resident memory elsewhere
    ===========================  ==================================================================

    Within an interval it reads the host's clock twice a batch and adds up numbers that the host
    knows. At its end it searches once more, and on CUDA it waits for the device, there, after the
    first step and before a validation, and nowhere else. Since a GPU works on while the host waits
    for data, `network_seconds` is the least it may be there. Of several processes the first one's
    times are logged, and `particles_per_second` as if the others had as many particles.
    """

    def setup(self, trainer: Trainer, pl_module: LightningModule, stage: str) -> None:
        """Checks who is trained.

        Raises:
            UserError: the module is not a FluidsNet.
        """
        if not isinstance(pl_module, FluidsNet):
            raise UserError("SpeedMonitor knows the neighbor search of FluidsNet alone.")

    def on_train_start(self, trainer: Trainer, pl_module: LightningModule) -> None:
        """Forgets an earlier training."""
        assert isinstance(pl_module, FluidsNet)
        # A copy: what the network's own search keeps of the last batch stays its own.
        self._search = deepcopy(pl_module.model.network.neighbors)
        self._warm = False
        self._began: float | None = None
        self._ended: float | None = None
        self._next_interval(trainer)

    def on_train_batch_start(
        self, trainer: Trainer, pl_module: LightningModule, batch: Transitions, batch_idx: int
    ) -> None:
        """Notes how long the batch was waited for."""
        now = time.perf_counter()
        if self._ended is not None:
            self._waited += now - self._ended
        else:
            self._began = now

    def on_train_batch_end(
        self,
        trainer: Trainer,
        pl_module: LightningModule,
        outputs: object,
        batch: Transitions,
        batch_idx: int,
    ) -> None:
        """Counts the batch, and logs where an interval ends."""
        if not self._warm:
            self._warm = trainer.global_step > self._first_step
            if not self._warm:
                return
            self._began = self._ended = _now(pl_module.device)
            self._next_interval(trainer)
            return
        self._batches += 1
        self._particles += len(batch.state) * len(batch.next_position)
        self._ended = time.perf_counter()
        steps = trainer.global_step - self._first_step
        every: int = trainer.log_every_n_steps  # type: ignore[attr-defined]
        if not (every and steps and trainer.global_step % every == 0):
            return
        self._pause(_now(pl_module.device))
        if trainer.is_global_zero and trainer.loggers:
            self._log(trainer, pl_module, batch, steps)
        self._began = self._ended = _now(pl_module.device)
        self._next_interval(trainer)

    def on_validation_start(self, trainer: Trainer, pl_module: LightningModule) -> None:
        """Stops the clock, which the next batch starts again."""
        if not trainer.sanity_checking and trainer.state.fn == "fit":
            self._pause(_now(pl_module.device))

    def _pause(self, now: float) -> None:
        if self._began is not None:
            self._seconds += now - self._began
        self._began = self._ended = None

    def _next_interval(self, trainer: Trainer) -> None:
        self._seconds = self._waited = 0.0
        self._batches = self._particles = 0
        self._first_step = trainer.global_step

    def _log(
        self, trainer: Trainer, module: LightningModule, batch: Transitions, steps: int
    ) -> None:
        assert isinstance(module, FluidsNet)
        started = _now(module.device)
        with torch.no_grad():
            self._search(batch.state)
        one = _now(module.device) - started
        # Each model, of several that train side by side, searches for itself.
        searches = self._batches * len(batch.next_position) * len(module.named_models())
        found = {
            "steps_per_second": steps / self._seconds,
            "particles_per_second": trainer.world_size * self._particles / self._seconds,
            "step_seconds": self._seconds / steps,
            "data_seconds": self._waited / steps,
            "search_seconds": one * searches / steps,
            "network_seconds": (self._seconds - self._waited - one * searches) / steps,
            "peak_memory_mb": peak_bytes(module.device) / 1e6,
        }
        for logger in trainer.loggers:
            # The step that Lightning logs this batch's loss at.
            logger.log_metrics(
                {f"speed/{name}": value for name, value in found.items()},
                step=trainer.global_step - 1,
            )


def _now(device: torch.device) -> float:
    """The host's clock once a GPU has done what it was told."""
    if device.type == "cuda":
        torch.cuda.synchronize(device)
    return time.perf_counter()
