"""Repair of a training loop's counters in a checkpoint."""

from __future__ import annotations

from typing import Any


def end_epoch(fit_loop: dict[str, Any]) -> None:
    """Count the epoch of a checkpoint that was saved after its last batch as ended.

    Lightning saves in the last hook of a batch, before it counts the batch; at the end of an epoch
    it then leaves out the whole next one (2.6). The validation of the ended epoch is left out.

    Args:
        fit_loop: State of the loop, ``checkpoint["loops"]["fit_loop"]``; changed in place.
    """
    batches, epochs = fit_loop["epoch_loop.batch_progress"], fit_loop["epoch_progress"]
    current, total = batches["current"], batches["total"]
    if not batches["is_last_batch"] or current["processed"] != current["completed"] + 1:
        return
    total["completed"] = total["processed"]
    batches["current"] = dict.fromkeys(current, 0)
    batches["is_last_batch"] = False
    for counts in (epochs["current"], epochs["total"]):
        # The next epoch has begun.
        counts.update({name: count + 1 for name, count in counts.items()})
