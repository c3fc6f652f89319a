"""Silence messages of Lightning and PyTorch that do not help the user of a command."""

from __future__ import annotations

import logging
import re
import warnings

# Regular expressions, matched at the start of a warning.
_WARNINGS = (
    ".*does not have many workers.*",
    ".*LightningCLI's args parameter is intended.*",
    ".*isinstance.treespec, LeafSpec.*",
    ".*is already saved during checkpointing.*",
    ".*predict returned None.*",
    ".*Grad strides do not match bucket view strides.*",
    "The dirpath has changed from .*",
    "Checkpoint directory .* exists and is not empty.*",
    ".*could not find the monitored key in the returned metrics.*",  # no validation yet
    "Experiment logs directory .* exists and is not empty.*",
    # The order of samples is resumed (datamodules/order.py).
    ".*a checkpoint that ended before the epoch ended and your dataloader is not resumable.*",
    "The number of training batches .* is smaller than the logging interval.*",
)
# Matched at the start of a log message. `RunSummary` prints device, model and folder instead.
_MESSAGES = re.compile(
    "💡 Tip"
    "|GPU available|TPU available"
    "|Seed set to"
    "|Restoring states from|Loaded model weights"
    "|Loading `train_dataloader` to estimate"
    "|`Trainer.fit` stopped"
    "|Trainer already configured with model summary"
)


def quiet() -> None:
    """Silence the messages listed in this module, and no others."""
    for pattern in _WARNINGS:
        warnings.filterwarnings("ignore", pattern)
    for library in ("fabric", "pytorch"):
        # Filters of a logger do not apply to its children: name the logger that is used.
        for module in ("rank_zero", "seed"):
            logging.getLogger(f"lightning.{library}.utilities.{module}").addFilter(_is_useful)


def _is_useful(record: logging.LogRecord) -> bool:
    return _MESSAGES.match(record.getMessage()) is None
