"""Preparation of a checkpoint for the training that goes on from it."""

from __future__ import annotations

import inspect
import json
from collections.abc import Mapping
from pydoc import locate
from typing import Any

from fluidsnet.errors import UserError

#: Key of the learning rate schedule's steps in a checkpoint.
SCHEDULED = "fluidsnet_schedule_steps"
# State of a learning rate schedule that says where it is; `lr_lambdas` are its functions' own.
_PLACE = {"last_epoch", "_step_count", "_last_lr", "lr_lambdas"}
# Key of the hyperparameters of a module that was built from a config.
_FROM_CONFIG = "_class_path"
# Settings of the blocks that a config leaves out (`FluidsNet.__init__`).
_BUILT_IN: dict[str, dict[str, Any]] = {
    "optimizer": {"class_path": "torch.optim.Adam", "init_args": {"lr": 0.003}},
    "schedule": {"class_path": "fluidsnet.schedule.HalfwayDrop", "init_args": {}},
}


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


def check_optimizer(checkpoint: Mapping[str, Any], settings: Mapping[str, Any]) -> None:
    """Check that a training resumes with the optimizer and schedule of its checkpoint.

    Their state is restored with all of its numbers, so others would have no effect.

    Args:
        checkpoint: Checkpoint.
        settings: Hyperparameters of the module.

    Raises:
        UserError: One differs.
    """
    saved: Mapping[str, Any] = checkpoint.get("hyper_parameters", {})
    if not all(_FROM_CONFIG in it for it in (saved, settings)):
        # Of a module built in Python, blocks are not known.
        return
    for block, built_in in _BUILT_IN.items():
        there, here = (it.get(block) or built_in for it in (saved, settings))
        if not all(isinstance(it, Mapping) and "class_path" in it for it in (there, here)):
            continue
        classes = [str(it["class_path"]) for it in (there, here)]
        if classes[0] != classes[1]:
            raise _differs(f"model.{block}", *classes)
        arguments = [it.get("init_args") or {} for it in (there, here)]
        for name in {**arguments[0], **arguments[1]}:
            # A later version of the class may have arguments that an earlier one had not.
            found = [it.get(name, _default(classes[0], name)) for it in arguments]
            if json.dumps(found[0]) != json.dumps(found[1]):
                raise _differs(f"model.{block}.init_args.{name}", *found)


def _default(class_path: str, name: str) -> Any:
    """Return the default of a class's argument; None without one."""
    made: Any = locate(class_path)
    parameter = inspect.signature(made).parameters.get(name) if made is not None else None
    return None if parameter is None or parameter.default is parameter.empty else parameter.default


def _differs(name: str, there: Any, here: Any) -> UserError:
    return UserError(
        f"{name} is {here}, and {there} in the checkpoint: a training resumes with the optimizer "
        f"and the schedule that it began with. Set {name} as it was."
    )
