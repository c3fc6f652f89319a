"""What a checkpoint says of the training that goes on from it."""

from __future__ import annotations

from typing import Any

from fluidsnet.errors import UserError

#: Key of the learning rate schedule's steps in a checkpoint.
SCHEDULED = "fluidsnet_schedule_steps"
# State of a learning rate schedule that says where it is; `lr_lambdas` are its functions' own.
_PLACE = {"last_epoch", "_step_count", "_last_lr", "lr_lambdas"}


def prepare_resume(checkpoint: dict[str, Any], stretched: bool) -> int:
    """Change a checkpoint in place so that training goes on where it was.

    Args:
        checkpoint: As Lightning reads it.
        stretched: Stretch what is left of the learning rate schedule over the steps of the new run.

    Returns:
        Steps of the schedule; 0 for those of the new run.

    Raises:
        UserError: The schedule cannot be stretched.
    """
    if "loops" in checkpoint:
        end_epoch(checkpoint["loops"]["fit_loop"])
    if not stretched:
        steps: int = checkpoint.get(SCHEDULED, 0)
        return steps
    for state in checkpoint.get("lr_schedulers", ()):
        if "_schedulers" in state:
            raise UserError("model.stretch_schedule: a chain of schedules has no length.")
        # Its place is restored, the steps that it was made for are not.
        for name in state.keys() - _PLACE:
            del state[name]
    return 0


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
