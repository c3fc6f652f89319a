from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
import torch
from lightning import Trainer
from lightning.pytorch.callbacks import ModelCheckpoint

from datamodules import SPHDataModule
from fluidsnet import FluidsNet
from fluidsnet.errors import UserError
from fluidsnet.features import NoGlobalFeature
from fluidsnet.integrator import Displacement
from fluidsnet.noise import StartNoise
from fluidsnet.target import AccelerationTarget, DisplacementTarget
from fluidsnet.walls import StopAtWalls


def data(sample: Path, **changes: Any) -> SPHDataModule:
    return SPHDataModule(**{"root": sample, "voxel_size": 0.25, "batch_size": 4, **changes})


def trainer(folder: Path, **changes: Any) -> Trainer:
    return Trainer(
        **{
            "default_root_dir": folder,
            "accelerator": "cuda" if torch.cuda.is_available() else "cpu",
            "devices": 1,
            "logger": False,
            "enable_checkpointing": False,
            "enable_progress_bar": False,
            "enable_model_summary": False,
            **changes,
        }
    )


def test_training_learns(sample: Path, tmp_path: Path) -> None:
    torch.manual_seed(0)
    source = data(sample)
    model = FluidsNet(source.grid_shape)
    runner = trainer(tmp_path, max_epochs=12)
    runner.fit(model, source)
    after = runner.callback_metrics
    # The velocity target starts from the mean velocity, whose loss is one.
    assert float(after["val/loss"]) < 0.6
    assert torch.isfinite(after["val/skill"])


@pytest.mark.parametrize("steps", [1, 3])
def test_variants_train_over_several_steps_with_noise(
    sample: Path, tmp_path: Path, steps: int
) -> None:
    source = data(sample, steps=steps)
    model = FluidsNet(
        source.grid_shape,
        global_feature=NoGlobalFeature,
        target=DisplacementTarget(),
        integrator=Displacement(),
        walls=StopAtWalls(),
        noise=StartNoise(),
    )
    runner = trainer(tmp_path, max_steps=3, limit_val_batches=1)
    runner.fit(model, source)
    assert torch.isfinite(runner.callback_metrics["train/loss"])


def test_the_loss_over_steps_is_that_of_each_step(sample: Path) -> None:
    source = data(sample, steps=2, batch_size=1)
    model = FluidsNet(
        source.grid_shape, global_feature=NoGlobalFeature, target=AccelerationTarget()
    )
    model.model.set_statistics(source.statistics, source.time_step)
    model.log = lambda *_, **__: None  # type: ignore[method-assign]
    batch = next(iter(source.train_dataloader()))
    found = model.training_step(batch, 0)
    network, guess = model.model.network, model.model.guess
    first = network(batch.state, guess(batch.state))
    wanted = network.target.encode(
        batch.state, guess(batch.state), batch.next_position[0], batch.next_velocity[0]
    )
    state = model(batch.state)
    second = network(state, guess(state))
    then = network.target.encode(
        state, guess(state), batch.next_position[1], batch.next_velocity[1]
    )
    expected = ((first - wanted).square().mean() + (second - then).square().mean()) / 2
    assert torch.allclose(found, expected, rtol=1e-5)


def test_scale_comes_from_the_training_data_and_stays_with_the_checkpoint(
    sample: Path, tmp_path: Path
) -> None:
    source = data(sample)
    model = FluidsNet(source.grid_shape)
    saver = ModelCheckpoint(dirpath=tmp_path, filename="kept")
    runner = trainer(tmp_path, max_steps=2, limit_val_batches=1, enable_checkpointing=True,
                     callbacks=[saver])  # fmt: skip
    runner.fit(model, source)
    again = FluidsNet.load_from_checkpoint(tmp_path / "kept.ckpt")
    deviation = source.statistics.velocity_deviation
    assert torch.equal(again.model.network.inputs.velocity_deviation.cpu(), deviation)
    assert torch.equal(again.model.network.target.deviation.cpu(), deviation)
    assert float(again.model.time_step) == pytest.approx(0.02)
    batch = next(iter(source.val_dataloader()))
    model.eval()
    again.eval()
    expected = model.cpu()(batch.state)
    assert torch.equal(again.cpu()(batch.state).position, expected.position)


def _keep(model: FluidsNet, source: SPHDataModule, folder: Path) -> Path:
    saver = ModelCheckpoint(dirpath=folder, filename="kept")
    runner = trainer(folder, max_steps=1, limit_val_batches=1, enable_checkpointing=True,
                     callbacks=[saver])  # fmt: skip
    runner.fit(model, source)
    return folder / "kept.ckpt"


def test_a_network_of_other_blocks_comes_back_from_its_checkpoint(
    sample: Path, tmp_path: Path
) -> None:
    source = data(sample)
    blocks: dict[str, Any] = {"target": DisplacementTarget(), "global_feature": NoGlobalFeature}
    model = FluidsNet(source.grid_shape, integrator=Displacement(), noise=StartNoise(), **blocks)
    kept = _keep(model, source, tmp_path)
    again = FluidsNet.load_from_checkpoint(kept, **blocks)
    for name, value in model.model.network.state_dict().items():
        assert torch.equal(again.model.network.state_dict()[name].cpu(), value.cpu())
    trainer(tmp_path).test(again, source, ckpt_path=kept, weights_only=True, verbose=False)


def test_a_checkpoint_of_other_blocks_or_another_grid_is_refused(
    sample: Path, tmp_path: Path
) -> None:
    source = data(sample)
    kept = _keep(FluidsNet(source.grid_shape), source, tmp_path)
    # Same shapes, another meaning.
    with pytest.raises(UserError, match=r"target VelocityTarget.*has AccelerationTarget"):
        FluidsNet.load_from_checkpoint(kept, target=AccelerationTarget())
    with pytest.raises(UserError, match=r"grid of 6 x 4 x 6 cells.*give 8 x 5 x 8.*voxel_size"):
        other = data(sample, voxel_size=0.2)
        trainer(tmp_path).test(FluidsNet(other.grid_shape), other, ckpt_path=kept, verbose=False)


def test_resuming_at_another_time_step_is_refused_before_training(
    sample: Path, tmp_path: Path
) -> None:
    source = data(sample)
    kept = _keep(FluidsNet(source.grid_shape), source, tmp_path)
    runner = trainer(tmp_path, max_steps=3)
    with pytest.raises(UserError, match=r"time step of 0.02 s.*stepped by 0.04 s"):
        runner.fit(FluidsNet(source.grid_shape), data(sample, stride=2), ckpt_path=kept)
    assert runner.global_step == 1


def test_the_learning_rate_falls_to_a_twentieth_halfway(sample: Path, tmp_path: Path) -> None:
    class Watch(FluidsNet):
        seen: list[float]

        def on_train_batch_start(self, batch: object, batch_index: int) -> None:
            self.seen.append(self.trainer.optimizers[0].param_groups[0]["lr"])

    source = data(sample, batch_size=2)
    model = Watch(source.grid_shape, global_feature=NoGlobalFeature)
    model.seen = []
    trainer(tmp_path, max_steps=10, limit_val_batches=1).fit(model, source)
    assert model.seen == pytest.approx([0.003] * 5 + [0.00015] * 5)


def test_an_integrator_that_needs_a_displacement_wants_a_target_that_gives_it() -> None:
    with pytest.raises(UserError, match="Displacement needs a target"):
        FluidsNet((6, 4, 6), integrator=Displacement())


def test_another_time_step_than_the_trained_one_is_refused(sample: Path, tmp_path: Path) -> None:
    source = data(sample)
    model = FluidsNet(source.grid_shape, global_feature=NoGlobalFeature)
    trainer(tmp_path, max_steps=1, limit_val_batches=1).fit(model, source)
    with pytest.raises(UserError, match=r"time step of 0.02 s.*stepped by 0.04 s"):
        trainer(tmp_path).test(model, data(sample, stride=2), verbose=False)


def test_an_untrained_network_is_not_tested(sample: Path, tmp_path: Path) -> None:
    source = data(sample)
    with pytest.raises(UserError, match="has not been trained"):
        trainer(tmp_path).test(FluidsNet(source.grid_shape), source, verbose=False)


def test_a_run_without_an_end_is_refused(sample: Path, tmp_path: Path) -> None:
    source = data(sample)
    with pytest.raises(UserError, match=r"max_epochs or trainer.max_steps"):
        trainer(tmp_path, max_epochs=-1).fit(FluidsNet(source.grid_shape), source)


def test_weight_counts_are_those_the_documentation_gives() -> None:
    counts = {}
    for cells in ((21, 21, 21), (18, 12, 18)):
        network = FluidsNet(cells).model.network
        context = network.global_feature
        counts[cells] = [
            sum(weight.numel() for weight in part.parameters())
            for part in (network.local, context.voxel, context.stack, context.reduce, network.head)
        ]
    assert counts == {
        (21, 21, 21): [128, 5712, 7040, 10336, 2259],
        (18, 12, 18): [128, 5712, 7168, 10336, 2259],
    }
