"""Speed of training, and the time of the parts of a step."""

from __future__ import annotations

import time
from copy import deepcopy

import torch
from lightning import Callback, LightningModule, Trainer

from fluidsnet.memory import peak_bytes
from fluidsnet.particles import Transitions
from fluidsnet.reporting.requirements import require_fluidsnet


class SpeedMonitor(Callback):
    """Log the speed of training under ``speed/``, every ``trainer.log_every_n_steps`` steps.

    ===========================  ==================================================================
    `steps_per_second`           steps of the optimizer, with reading the data, but without
                                 validations, the first step, which compiles, and the search that
                                 this callback times
    `particles_per_second`       fluid particles, times the steps predicted of each
    `step_seconds`               1 / `steps_per_second`
    `data_seconds`               part of a step: waiting for the next batch
    `search_seconds`             part of a step: its neighbor searches, each as long as a search
                                 that is timed at the end of the interval
    `network_seconds`            part of a step: the rest, that is forward and backward pass and
                                 the optimizer
    `peak_memory_mb`             greatest memory so far, 10⁶ bytes: allocated by torch on CUDA,
                                 resident memory of the process elsewhere
    ===========================  ==================================================================

    Within an interval the host's clock is read twice per batch. CUDA is synchronized only at the
    end of an interval, after the first step and before a validation. Since a GPU works while the
    host waits for data, `network_seconds` is a lower bound there. Of several processes, the times
    of the first are logged, and `particles_per_second` assumes as many particles in the others.
    """

    def setup(self, trainer: Trainer, pl_module: LightningModule, stage: str) -> None:
        """Check the module."""
        require_fluidsnet(self, pl_module)

    def on_train_start(self, trainer: Trainer, pl_module: LightningModule) -> None:
        """Reset the measurement."""
        # A copy, since a search caches the sorted solids of its last batch.
        self._search = deepcopy(require_fluidsnet(self, pl_module).model.network.neighbors)
        self._warm = False
        self._began: float | None = None
        self._ended: float | None = None
        self._next_interval(trainer)

    def on_train_batch_start(
        self, trainer: Trainer, pl_module: LightningModule, batch: Transitions, batch_idx: int
    ) -> None:
        """Add the time waited for the batch."""
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
        """Count the batch, and log at the end of an interval."""
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
        """Pause the clock until the next batch."""
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
        started = _now(module.device)
        with torch.no_grad():
            self._search(batch.state)
        search = _now(module.device) - started
        # Each model, twins included, has its search.
        models = require_fluidsnet(self, module).named_models()
        searches = self._batches * len(batch.next_position) * len(models)
        speeds = {
            "steps_per_second": steps / self._seconds,
            "particles_per_second": trainer.world_size * self._particles / self._seconds,
            "step_seconds": self._seconds / steps,
            "data_seconds": self._waited / steps,
            "search_seconds": search * searches / steps,
            "network_seconds": (self._seconds - self._waited - search * searches) / steps,
            "peak_memory_mb": peak_bytes(module.device) / 1e6,
        }
        for logger in trainer.loggers:
            # Lightning logs the loss of this batch at this step.
            logger.log_metrics(
                {f"speed/{name}": value for name, value in speeds.items()},
                step=trainer.global_step - 1,
            )


def _now(device: torch.device) -> float:
    """Return the host's clock, s, after synchronizing CUDA."""
    if device.type == "cuda":
        torch.cuda.synchronize(device)
    return time.perf_counter()
