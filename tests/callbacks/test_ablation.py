from __future__ import annotations

import copy
from collections.abc import Iterator
from functools import partial
from pathlib import Path
from typing import Any

import pytest
import torch
from lightning import Callback, LightningModule, Trainer
from lightning.pytorch.callbacks import ModelCheckpoint
from shared_fit import InOrder
from torch import Tensor

from callbacks import Ablation
from datamodules import SPHDataModule
from fluidsnet import FluidsNet
from fluidsnet.errors import UserError
from fluidsnet.features import GlobalVector, NoGlobalFeature
from fluidsnet.integrator import Euler, Trapezoid
from fluidsnet.noise import StartNoise
from fluidsnet.rng import preserve_rng_state, with_same_rng
from fluidsnet.target import AccelerationTarget, VelocityTarget
from fluidsnet.walls import StopAtWalls

Weights = dict[str, Tensor]
DEVICE = "cuda" if torch.cuda.is_available() else "cpu"


MADE: list[SPHDataModule] = []


@pytest.fixture(autouse=True)
def closed() -> Iterator[None]:
    """Closes the data's files, which a fit that is refused leaves open."""
    yield
    while MADE:
        MADE.pop().teardown("fit")


def data(sample: Path, kind: type[SPHDataModule] = SPHDataModule) -> SPHDataModule:
    MADE.append(kind(sample, voxel_size=0.25, batch_size=2, sample_every=6, rollout_steps=1))
    return MADE[-1]


def trainer(folder: Path, *callbacks: Callback, **changes: Any) -> Trainer:
    return Trainer(
        **{
            "default_root_dir": folder,
            "accelerator": DEVICE,
            "devices": 1,
            "logger": False,
            "enable_checkpointing": False,
            "enable_progress_bar": False,
            "enable_model_summary": False,
            "num_sanity_val_steps": 0,
            "limit_val_batches": 1,
            "callbacks": list(callbacks),
            **changes,
        }
    )


def weights(model: torch.nn.Module) -> Weights:
    return {name: value.detach().cpu().clone() for name, value in model.state_dict().items()}


class FirstWeights(Callback):
    """Keeps the weights that a twin starts from."""

    def on_fit_start(self, trainer: Trainer, pl_module: LightningModule) -> None:
        assert isinstance(pl_module, FluidsNet)
        self.kept = weights(pl_module.models["other"])


def assert_equal(found: Weights, expected: Weights) -> None:
    assert found.keys() == expected.keys()
    for name, value in expected.items():
        assert torch.equal(found[name], value), name


def test_a_twin_differs_in_its_block_alone_and_starts_from_the_same_weights() -> None:
    torch.manual_seed(0)
    model = FluidsNet((6, 4, 6), noise=StartNoise(0.3), walls=StopAtWalls(0.5))
    with preserve_rng_state():
        expected = torch.rand(3)
    target, context = (
        model.model.twin({"target": AccelerationTarget()}),
        model.model.twin({"global_feature": NoGlobalFeature}),
    )
    assert torch.equal(torch.rand(3), expected)
    for twin, changed in ((target, "target"), (context, "global_feature")):
        for name, block in twin.blocks().items():
            mine = model.model.blocks()[name]
            assert block is not mine
            assert (type(block) is type(mine)) == (name != changed)
        theirs = {value.data_ptr() for value in twin.parameters()}
        assert not theirs & {value.data_ptr() for value in model.parameters()}
    assert_equal(weights(target), weights(model.model))
    own, mine = weights(context), weights(model.model)
    # The head's first layer has nothing to look at where the vector was.
    assert {name for name in own if own[name].shape != mine[name].shape} == {
        "network.head.0.weight"
    }
    del own["network.head.0.weight"]
    assert_equal(own, {name: mine[name] for name in own})
    assert isinstance(context.noise, StartNoise) and context.noise.most == 0.3


@pytest.mark.parametrize("clip", [None, 0.05])
@pytest.mark.parametrize("block", ["target", "global_feature"])
def test_model_and_twin_train_as_each_would_alone(
    sample: Path, tmp_path: Path, block: str, clip: float | None
) -> None:
    changed: dict[str, Any] = {
        "target": {"target": AccelerationTarget()},
        "global_feature": {"global_feature": NoGlobalFeature},
    }[block]
    # Without a vector no empty cells are drawn, and noise drawn after them would be another.
    blocks: dict[str, Any] = {"noise": StartNoise()} if block == "target" else {}

    def run(model: FluidsNet, *callbacks: Callback) -> None:
        torch.manual_seed(1)
        trainer(tmp_path, *callbacks, max_steps=5, gradient_clip_val=clip).fit(model, data(sample))

    torch.manual_seed(0)
    cells = data(sample).grid_shape
    alone = FluidsNet(cells, **blocks)
    beside = copy.deepcopy(alone)
    run(alone)
    first = FirstWeights()
    run(beside, Ablation(block, *changed.values(), "other"), first)
    separate = FluidsNet(cells, **{**copy.deepcopy(blocks), **copy.deepcopy(changed)})
    separate.model.load_state_dict(first.kept)
    run(separate)
    found, twin = weights(beside.model), weights(beside.models["other"])
    assert_equal(found, weights(alone.model))
    assert_equal(twin, weights(separate.model))
    for trained, start in ((twin, first.kept), (found, twin)):
        assert not torch.equal(trained["network.head.0.bias"], start["network.head.0.bias"])


def _trained(sample: Path, folder: Path, **changes: Any) -> tuple[FluidsNet, Path]:
    """Two epochs beside a twin, and the checkpoint of the first; nothing is drawn."""
    source = data(sample, InOrder)
    torch.manual_seed(0)
    model = FluidsNet(source.grid_shape, global_feature=partial(GlobalVector, empty_variance=0.0))
    saver = ModelCheckpoint(folder, filename="{epoch}", save_top_k=-1)
    run = trainer(
        folder, Ablation("global_feature", NoGlobalFeature, "other"), saver,
        max_epochs=2, limit_train_batches=3, enable_checkpointing=True, **changes,
    )  # fmt: skip
    run.fit(model, source)
    return model, folder / "epoch=0.ckpt"


def test_a_resumed_training_ends_where_an_uninterrupted_one_does(
    sample: Path, tmp_path: Path
) -> None:
    model, kept = _trained(sample, tmp_path)
    source = data(sample, InOrder)
    again = FluidsNet(source.grid_shape, global_feature=partial(GlobalVector, empty_variance=0.0))
    run = trainer(
        tmp_path,
        Ablation("global_feature", NoGlobalFeature, "other"),
        max_epochs=2,
        limit_train_batches=3,
    )
    run.fit(again, source, ckpt_path=kept, weights_only=True)
    assert_equal(weights(again), weights(model))


def test_a_checkpoint_can_be_used_without_its_twin_but_not_resumed(
    sample: Path, tmp_path: Path
) -> None:
    model, kept = _trained(sample, tmp_path)
    source = data(sample)
    alone = FluidsNet.load_from_checkpoint(kept)
    expected = {name for name in model.state_dict() if not name.startswith("models.other.")}
    assert alone.state_dict().keys() == expected
    plain = FluidsNet(source.grid_shape)
    found = trainer(tmp_path).test(plain, source, ckpt_path=kept, verbose=False)[0]
    assert not [name for name in found if "other" in name]
    trainer(tmp_path, Ablation("global_feature", NoGlobalFeature, "other")).predict(
        FluidsNet(source.grid_shape), source, ckpt_path=kept
    )

    def resume(*callbacks: Callback) -> None:
        run = trainer(tmp_path, *callbacks, max_epochs=2)
        run.fit(FluidsNet(source.grid_shape), source, ckpt_path=kept)

    with pytest.raises(UserError, match="beside a twin 'other'"):
        resume()
    with pytest.raises(UserError, match="holds no twin 'another'"):
        resume(Ablation("global_feature", NoGlobalFeature, "another"))
    with pytest.raises(
        UserError, match=r"'other' .* has the global_feature NoGlobalFeature.*GlobalVector"
    ):
        resume(Ablation("integrator", Trapezoid(), "other"))


def test_a_twin_of_a_block_without_weights_is_known_by_it(sample: Path, tmp_path: Path) -> None:
    source = data(sample)
    saver = ModelCheckpoint(tmp_path, filename="kept")
    run = trainer(
        tmp_path, Ablation("integrator", Trapezoid(), "other"), saver,
        max_steps=1, enable_checkpointing=True,
    )  # fmt: skip
    run.fit(FluidsNet(source.grid_shape, global_feature=NoGlobalFeature), source)
    model = FluidsNet(source.grid_shape, global_feature=NoGlobalFeature)
    with pytest.raises(UserError, match=r"'other' .* has the integrator Trapezoid.*Euler"):
        trainer(tmp_path, Ablation("walls", StopAtWalls(), "other")).test(
            model, source, ckpt_path=tmp_path / "kept.ckpt", verbose=False
        )


def test_several_twins_train_beside_one_model_and_are_measured(
    sample: Path, tmp_path: Path
) -> None:
    source = data(sample)
    model = FluidsNet(source.grid_shape, global_feature=NoGlobalFeature)
    ablations = (
        Ablation("target", AccelerationTarget(), "acceleration"),
        Ablation("integrator", Trapezoid(), "trapezoid"),
        Ablation("head", [8], "narrow"),
    )
    run = trainer(  # two steps
        tmp_path,
        *ablations,
        max_epochs=1,
        limit_train_batches=4,
        accumulate_grad_batches=2,
        precision="bf16-mixed",
    )
    run.fit(model, source)
    figures = run.callback_metrics
    for name in ("model", "acceleration", "trapezoid", "narrow"):
        for figure in ("train_loss", "velocity_mse", "skill", "position_error_1_mm"):
            assert torch.isfinite(figures[f"ablation/{figure}/{name}"])
    for figure in ("velocity_mse", "skill", "position_error_1_mm"):
        assert figures[f"ablation/{figure}/model"] == figures[f"val/{figure}"]
    # The same weights, and another way to move.
    assert figures["ablation/velocity_mse/trapezoid"] == figures["val/velocity_mse"]
    assert figures["ablation/position_error_1_mm/trapezoid"] != figures["val/position_error_1_mm"]
    # Twins that the module has are kept, by new callbacks too.
    again = (Ablation("target", AccelerationTarget(), "acceleration"), *ablations[1:])
    tested = trainer(tmp_path, *again).test(model, source, verbose=False)[0]
    assert {f"test/{name}/skill" for name in model.named_models()} <= tested.keys()
    with pytest.raises(UserError, match="already has a twin 'narrow'"):
        trainer(tmp_path, Ablation("head", [4], "narrow")).test(model, source, verbose=False)


@pytest.mark.parametrize(
    ("block", "variant", "name", "words"),
    [
        (
            "targets",
            AccelerationTarget(),
            "other",
            "no block 'targets'; the blocks are global_feature, head,",
        ),
        ("optimizer", None, "other", "no block 'optimizer'"),
        ("target", Trapezoid(), "other", "Trapezoid cannot be the target"),
        (
            "global_feature",
            AccelerationTarget(),
            "other",
            "AccelerationTarget cannot be the global_feature",
        ),
        ("walls", None, "other", "None cannot be the walls"),
        ("head", "32", "other", "32 cannot be the head"),
        ("target", AccelerationTarget(), "model", "'model' is taken"),
        ("target", AccelerationTarget(), "ballistic", "'ballistic' is taken"),
        ("target", AccelerationTarget(), "truth", "'truth' is taken"),
        ("target", AccelerationTarget(), "keys", "'keys' is taken"),
        ("target", AccelerationTarget(), "a/b", "'a/b' is taken or has characters other"),
    ],
)
def test_what_cannot_be_a_twin_is_refused(block: str, variant: Any, name: str, words: str) -> None:
    with pytest.raises(UserError, match=words):
        Ablation(block, variant, name)


@pytest.mark.parametrize(
    ("block", "variant"),
    [
        ("target", VelocityTarget()),
        ("global_feature", GlobalVector),
        ("global_feature", partial(GlobalVector, seed=0)),
        ("integrator", Euler()),
        ("head", [32, 16, 8]),
        ("noise", None),
    ],
)
def test_a_twin_that_would_not_differ_is_refused(
    sample: Path, tmp_path: Path, block: str, variant: Any
) -> None:
    source = data(sample)
    with pytest.raises(UserError, match="name a variant that differs"):
        trainer(tmp_path, Ablation(block, variant, "other"), max_steps=1).fit(
            FluidsNet(source.grid_shape), source
        )


@pytest.mark.parametrize(
    ("block", "variant"),
    [
        ("global_feature", partial(GlobalVector, separable=False)),
        ("global_feature", partial(GlobalVector, empty_variance=0.1)),
        ("walls", StopAtWalls(0.5)),
        ("noise", StartNoise(0.2)),
    ],
)
def test_other_settings_make_a_twin(block: str, variant: Any) -> None:
    model = FluidsNet((6, 4, 6), walls=StopAtWalls(), noise=StartNoise())
    ablation = Ablation(block, variant, "other")
    ablation.setup(Trainer(logger=False, callbacks=[ablation]), model, "test")
    assert list(model.named_models()) == ["model", "other"]


def test_two_twins_of_one_name_and_scaled_losses_are_refused(sample: Path, tmp_path: Path) -> None:
    source, twin = data(sample), ("global_feature", NoGlobalFeature, "other")
    with pytest.raises(UserError, match="Two callbacks Ablation have the name 'other'"):
        trainer(tmp_path, Ablation(*twin), Ablation(*twin), max_steps=1).fit(
            FluidsNet(source.grid_shape), source
        )
    run = trainer(tmp_path, Ablation(*twin), max_steps=1)
    run.strategy.precision_plugin.scaler = object()  # type: ignore[attr-defined]
    with pytest.raises(UserError, match="use bf16-mixed or 32"):
        run.fit(FluidsNet(source.grid_shape), source)


def test_calls_draw_alike_and_leave_what_the_first_leaves(device: torch.device) -> None:
    def draw(count: int) -> Tensor:
        return torch.rand(count, device=device)

    torch.manual_seed(0)
    first, later = draw(2), draw(1)
    torch.manual_seed(0)
    results = with_same_rng(device, [partial(draw, 2), partial(draw, 5), partial(draw, 1)])
    assert all(torch.equal(result[0], first[0]) for result in results)
    assert torch.equal(draw(1), later)
