from __future__ import annotations

import pytest
from lightning import LightningModule, Trainer

from callbacks import CompiledNetwork
from fluidsnet.errors import UserError
from fluidsnet.module import FluidsNet


def test_compiling_renames_no_weight_and_stores_nothing() -> None:
    module = FluidsNet((6, 4, 6))
    names = list(module.state_dict())
    CompiledNetwork().setup(Trainer(logger=False), module, "predict")
    assert list(module.state_dict()) == names
    for part in (
        module.model.network.local,
        module.model.network.global_feature,
        module.model.network.head,
    ):
        assert part._compiled_call_impl is not None


def test_it_compiles_no_other_module() -> None:
    with pytest.raises(UserError, match="CompiledNetwork needs the model FluidsNet"):
        CompiledNetwork().setup(Trainer(logger=False), LightningModule(), "predict")
