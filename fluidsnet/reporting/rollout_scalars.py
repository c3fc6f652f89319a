"""The scalars of measured rollouts."""

from __future__ import annotations

from lightning import Trainer

from fluidsnet.metrics.rollout_suite import Figures
from fluidsnet.module import FluidsNet

#: Numbers of steps that are logged and have a row, beside the last step.
STEPS = (1, 2, 5, 10, 25, 50, 100, 200, 500, 1000, 2000, 5000)

#: By predictor, by metric and number of steps.
Scalars = dict[str, dict[str, float]]


def logged_steps(longest: int) -> list[int]:
    """Numbers of steps that are logged and have a row.

    Args:
        longest: steps of the longest rollout.
    """
    return sorted({*(step for step in STEPS if step <= longest), longest})


def scalars_of(figures: Figures, longest: int) -> Scalars:
    """What is logged: a number for each predictor, metric and number of steps.

    Args:
        figures: of the rollouts.
        longest: steps of the longest rollout.
    """
    return {
        predictor: {
            f"{name}/{step}": float(values[step - 1])
            for name, values in of.items()
            if name != "non_finite_step"
            for step in logged_steps(longest)
            if not values[step - 1].isnan()
        }
        for predictor, of in figures.items()
    }


def log_beside(trainer: Trainer, module: FluidsNet, group: str, scalars: Scalars) -> None:
    """Logs the predictors', and of models that train side by side each one's."""
    models = {name: scalars.pop(name) for name in module.named_models()}
    log_scalars(trainer, f"{group}_predictors", scalars)
    if len(models) > 1:
        log_scalars(trainer, f"ablation_{group}", models)


def log_scalars(trainer: Trainer, group: str, scalars: Scalars) -> None:
    """Logs to the loggers alone: these are for looking at beside the model's."""
    values = {
        f"{group}/{name}/{predictor}".removesuffix("/"): value
        for predictor, of in scalars.items()
        for name, value in of.items()
    }
    # In training, the step that Lightning logs the module's own figures at.
    step = trainer.global_step
    if trainer.state.fn == "fit":
        step = trainer.fit_loop.epoch_loop._batches_that_stepped
    for logger in trainer.loggers:
        logger.log_metrics(values, step=step)
