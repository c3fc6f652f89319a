"""Scalars of measured rollouts in the loggers."""

from __future__ import annotations

from lightning import Trainer

from fluidsnet.metrics.suite import RolloutResults
from fluidsnet.module import FluidsNet

#: Numbers of steps that are logged and have a row in tables, besides the last step.
STEPS = (1, 2, 5, 10, 25, 50, 100, 200, 500, 1000, 2000, 5000)

#: Values by predictor and by "<metric>/<steps>".
Scalars = dict[str, dict[str, float]]


def logged_steps(results: RolloutResults) -> list[int]:
    """Return the numbers of steps that are logged and have a row; none if nothing was measured."""
    last = int((results["model"]["simulations"] > 0).sum())
    return sorted({*(step for step in STEPS if step <= last), last} - {0})


def rollout_scalars(results: RolloutResults) -> Scalars:
    """Return the values of each predictor and metric after the logged numbers of steps."""
    return {
        predictor: {
            f"{name}/{step}": float(values[step - 1])
            for name, values in metrics.items()
            if name not in ("non_finite_step", "simulations")
            for step in logged_steps(results)
            if not values[step - 1].isnan()
        }
        for predictor, metrics in results.items()
    }


def log_predictors(trainer: Trainer, module: FluidsNet, group: str, scalars: Scalars) -> None:
    """Log the baselines and, if there are several models, each model.

    Args:
        trainer: Trainer with the loggers.
        module: Module with the models.
        group: Name that the groups of tags are made from.
        scalars: Values of the models and the baselines.
    """
    models = {name: scalars[name] for name in module.named_models()}
    baselines = {name: values for name, values in scalars.items() if name not in models}
    log_scalars(trainer, f"{group}_predictors", baselines)
    if len(models) > 1:
        log_scalars(trainer, f"ablation_{group}", models)


def log_scalars(trainer: Trainer, group: str, scalars: Scalars) -> None:
    """Log values to the loggers, as ``<group>/<metric>/<steps>/<predictor>``."""
    tagged = {
        f"{group}/{name}/{predictor}".removesuffix("/"): value
        for predictor, values in scalars.items()
        for name, value in values.items()
    }
    # In training, the step that Lightning logs the module's metrics at.
    step = trainer.global_step
    if trainer.state.fn == "fit":
        step = trainer.fit_loop.epoch_loop._batches_that_stepped
    for logger in trainer.loggers:
        logger.log_metrics(tagged, step=step)
