"""Optimizers and schedules of a training that is resumed."""

from __future__ import annotations

from typing import Any

import pytest

from fluidsnet.errors import UserError
from fluidsnet.resume import check_optimizer

ADAM = {"class_path": "torch.optim.Adam", "init_args": {"lr": 0.003, "weight_decay": 0}}


def settings(optimizer: Any) -> dict[str, Any]:
    """Return hyperparameters of a module from a config."""
    return {"_class_path": "fluidsnet.FluidsNet", "optimizer": optimizer, "schedule": None}


@pytest.mark.parametrize(
    "here",
    [
        ADAM,
        None,
        # Of a version of the class with further arguments.
        {**ADAM, "init_args": {"lr": 0.003, "amsgrad": False}},
    ],
)
def test_the_same_optimizer_in_other_words_is_taken(here: Any) -> None:
    check_optimizer({"hyper_parameters": settings(ADAM)}, settings(here))


@pytest.mark.parametrize(
    ("here", "message"),
    [
        ({"class_path": "torch.optim.SGD"}, "model.optimizer is torch.optim.SGD, and torch.optim"),
        ({**ADAM, "init_args": {"lr": 0.1}}, "model.optimizer.init_args.lr is 0.1, and 0.003 in"),
        (
            {**ADAM, "init_args": {"lr": 0.003, "weight_decay": 0.1}},
            "weight_decay is 0.1, and 0 in the checkpoint",
        ),
    ],
)
def test_another_optimizer_is_refused_by_name(here: Any, message: str) -> None:
    with pytest.raises(UserError, match=message):
        check_optimizer({"hyper_parameters": settings(ADAM)}, settings(here))
