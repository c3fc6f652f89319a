"""A network that corrects a coarse SPH step: statistics, training, checkpoint, baseline row."""

from __future__ import annotations

from pathlib import Path

import pytest
import torch
from lightning.pytorch.callbacks import ModelCheckpoint
from test_module import data, trainer

from callbacks import PriorBaseline
from fluidsnet import FluidsNet
from fluidsnet.calibration import measure_residuals
from fluidsnet.errors import UserError
from fluidsnet.features import ContinuousConvolutions, NoGlobalFeature, PriorState
from fluidsnet.integrator import Displacement
from fluidsnet.kernels import disabled
from fluidsnet.model import Model
from fluidsnet.noise import StartNoise
from fluidsnet.particles import Transitions
from fluidsnet.priors import FreeFall, PressureStep, Prior
from fluidsnet.target import DisplacementTarget, PriorAlone


def network(grid_shape: tuple[int, int, int], prior: Prior | None = None) -> FluidsNet:
    return FluidsNet(
        grid_shape,
        prior=prior or PressureStep(divergence_sweeps=0),
        inputs=PriorState(),
        local=ContinuousConvolutions(16, 8),
        global_feature=NoGlobalFeature,
        target=DisplacementTarget(),
        integrator=Displacement(),
        noise=StartNoise(0.1),
    )


def test_the_scale_is_what_the_prior_leaves(sample: Path) -> None:
    source = data(sample)
    source.setup("fit")
    prior = PressureStep(divergence_sweeps=0)
    found = measure_residuals(prior, source.calibration_samples(8))
    changes, drifts, columns = [], [], []
    for row in range(0, 120, 15):
        dataset = source._dataset("train", steps=1)
        state, next_position, next_velocity = (
            (it := dataset[row]).state, it.next_position[0], it.next_velocity[0]
        )  # fmt: skip
        guess = prior(state, True)
        changes.append(next_velocity - guess.velocity)
        drifts.append((next_position - guess.position) / state.scene.support_radius)
        columns.append(guess.columns)
    assert len(source._dataset("train", steps=1)) == 120
    for value, parts in (
        (found.change_deviation, changes),
        (found.drift_deviation, drifts),
    ):
        torch.testing.assert_close(value, torch.cat(parts).square().mean().sqrt())
    torch.testing.assert_close(
        found.column_mean, torch.cat(columns).mean(dim=0), atol=1e-5, rtol=1e-4
    )
    # The step leaves a part of what free fall leaves.
    free = measure_residuals(FreeFall(), source.calibration_samples(8))
    assert found.change_deviation < 0.5 * free.change_deviation
    assert free.column_mean.shape == (0,)


def test_it_trains_beats_nothing_learned_and_comes_back(
    sample: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    torch.manual_seed(0)
    source = data(sample, batch_size=2)
    module = network(source.grid_shape)
    saver = ModelCheckpoint(dirpath=tmp_path, filename="kept")
    runner = trainer(
        tmp_path, max_steps=30, val_check_interval=30, limit_val_batches=2,
        enable_checkpointing=True, callbacks=[saver],
    )  # fmt: skip
    runner.fit(module, source)
    assert float(runner.callback_metrics["val/skill"]) > 0.8
    again = network(source.grid_shape)
    tester = trainer(tmp_path, callbacks=[PriorBaseline()])
    tester.test(again, source, ckpt_path=tmp_path / "kept.ckpt")
    values = tester.callback_metrics
    assert {"test/model/skill", "test/prior/skill"} <= values.keys()
    alone = Model(
        source.grid_shape, prior=PressureStep(divergence_sweeps=0), target=PriorAlone(),
        integrator=Displacement(), global_feature=NoGlobalFeature,
    )  # fmt: skip
    state = source._dataset("test", steps=1)[7].state
    torch.testing.assert_close(
        again.models["prior"].step(state).position, alone.step(state).position
    )
    with pytest.raises(UserError, match="made with the inputs PriorState, and this network has"):
        FluidsNet.load_from_checkpoint(tmp_path / "kept.ckpt", prior=PressureStep())


def test_the_output_is_the_same_by_kernels_and_torch(sample: Path) -> None:
    torch.manual_seed(0)
    source = data(sample)
    source.setup("fit")
    model = network(source.grid_shape).model.eval()
    model.set_statistics(source.statistics, source.time_step)
    model.set_residuals(measure_residuals(model.prior, source.calibration_samples(4)))
    state = source._dataset("train", steps=1)[20].state
    with torch.no_grad():
        found = model.step(state)
        with disabled():
            expected = model.step(state)
    torch.testing.assert_close(found.position, expected.position, atol=2e-5, rtol=1e-4)
    torch.testing.assert_close(found.velocity, expected.velocity, atol=2e-3, rtol=1e-3)


def test_the_loss_reaches_the_weights_through_several_steps(sample: Path) -> None:
    source = data(sample, steps=2, batch_size=2)
    model = network(source.grid_shape).model
    model.set_statistics(source.statistics, source.time_step)
    batch = next(iter(source.train_dataloader()))
    model.loss(batch).backward()
    for name, weight in model.named_parameters():
        assert weight.grad is not None and weight.grad.abs().max() > 0, name


def test_a_warm_up_learns_from_the_state_that_it_reaches(sample: Path) -> None:
    source = data(sample, steps=3, batch_size=2)
    model = network(source.grid_shape).model
    model.set_statistics(source.statistics, source.time_step)
    model.noise = None
    batch = next(iter(source.train_dataloader()))
    with torch.no_grad():
        reached = model.step(model.step(batch.state))
    last = Transitions(reached, batch.next_position[2:], batch.next_velocity[2:], batch.simulation)
    model.loss(last).backward()
    expected = {name: weight.grad.clone() for name, weight in model.named_parameters()}
    model.zero_grad()
    model.loss(batch, warm_up=2).backward()
    for name, weight in model.named_parameters():
        torch.testing.assert_close(weight.grad, expected[name], msg=name)
    with pytest.raises(UserError, match=r"3 step\(s\), and a warm-up takes 3; set data"):
        model.loss(batch, warm_up=3)
    with pytest.raises(UserError, match="warm_up is -1"):
        FluidsNet(source.grid_shape, warm_up=-1)


def test_blocks_that_read_the_prior_need_one_that_describes_itself() -> None:
    with pytest.raises(UserError, match=r"need a prior that knows neighbors .* FreeFall does not"):
        network((3, 3, 3), FreeFall())


def test_a_guess_that_nothing_reads_is_not_computed(sample: Path) -> None:
    source = data(sample)
    source.setup("fit")
    state = source._dataset("train", steps=1)[20].state
    paper = Model(source.grid_shape, prior=PressureStep())
    assert torch.equal(paper.guess(state).position, state.position)
    assert not torch.equal(network(source.grid_shape).model.guess(state).position, state.position)
    falling = Model(source.grid_shape, target=DisplacementTarget(), integrator=Displacement())
    torch.testing.assert_close(falling.guess(state).position, FreeFall()(state).position)


def test_the_prior_alone_has_nothing_to_train() -> None:
    model = Model((3, 3, 3), target=PriorAlone(), integrator=Displacement())
    assert model.is_trained
    with pytest.raises(UserError, match="The prior FreeFall alone has no weights to train"):
        model.check_trainable()
